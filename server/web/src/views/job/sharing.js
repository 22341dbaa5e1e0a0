/** Links by which others see a job: made, copied and revoked. */
import { announce } from "../../announce.js";
import { del, get, post } from "../../api.js";
import { confirmed } from "../../confirm.js";
import { fill, h } from "../../dom.js";
import { when } from "../../format.js";
import { problemNotice } from "../../problem_notice.js";

const OWN_MACHINE = /^(localhost|127\..*|\[::1\])$/;

/** The section of the share links of a job. */
export class Sharing {
  /** @param {{jobId: string, signal: AbortSignal}} options */
  constructor({ jobId, signal }) {
    Object.assign(this, { path: `/jobs/${jobId}/share-links`, signal });
    this.trouble = h("div");
    this.links = h("ul", { class: "share-links" });
    this.element = h(
      "section",
      { class: "sharing", "aria-labelledby": "sharing" },
      h("h2", { id: "sharing" }, "Share"),
      h(
        "p",
        { class: "quiet small" },
        "Anyone with a link can see this job and save its result, without a key, until you revoke the link. ",
        OWN_MACHINE.test(location.hostname) && "This address is only valid on your own machine; others cannot use it.",
      ),
      this.links,
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", class: "compact", on: { click: (event) => this.#make(event) } }, "Make a link"),
      ),
      this.trouble,
    );
    this.#list();
  }

  async #list() {
    try {
      const known = await get(this.path, { signal: this.signal, quiet: true });
      this.links.prepend(...known.map((link) => this.#entry(link)));
    } catch (error) {
      if (error.name !== "Problem" && !this.signal.aborted) throw error; // without the list, links can still be made
    }
  }

  async #make({ currentTarget: pressed }) {
    if (pressed.hasAttribute("aria-disabled")) return; // a double click is one link
    pressed.setAttribute("aria-disabled", "true"); // a disabled one would lose the focus
    try {
      fill(this.trouble);
      const link = await post(this.path, null, { signal: this.signal });
      const entry = this.#entry(link);
      this.links.append(entry);
      entry.querySelector("input").select();
      announce("The link has been made.");
    } catch (error) {
      this.#fault(error);
    } finally {
      pressed.removeAttribute("aria-disabled");
    }
  }

  /** A link; only one that has just been made has an address to copy. */
  #entry(link) {
    const made = `Made ${when(link.created_at)}`;
    const revoke = h(
      "button",
      { type: "button", class: "compact", "aria-label": `Revoke the link: ${made}`, on: { click: () => this.#revoke(link, entry) } },
      "Revoke",
    );
    const entry = h("li", null, link.path ? this.#address(link) : h("span", { class: "small" }, made), revoke);
    return entry;
  }

  #address({ path }) {
    const value = new URL(path, location.origin).href;
    const input = h("input", { value, readonly: true, "aria-label": "Address of the link", on: { focus: () => input.select() } });
    const copy = async () => {
      await copied(input);
      announce("The link has been copied.");
      button.textContent = "Copied";
    };
    const button = h("button", { type: "button", class: "compact", on: { click: copy } }, "Copy");
    return [input, button];
  }

  async #revoke(link, entry) {
    const question = {
      title: "Revoke this link?",
      text: "Anyone who has it will no longer see the job. This cannot be undone.",
      action: "Revoke",
    };
    if (!(await confirmed(question))) return;
    try {
      fill(this.trouble);
      await del(`${this.path}/${link.id}`, { signal: this.signal });
    } catch (error) {
      if (error.status !== 404) return this.#fault(error); // else somebody has revoked it already
    }
    entry.remove();
    announce("The link has been revoked.");
    this.element.querySelector(".row button").focus();
  }

  #fault(error) {
    if (this.signal.aborted) return;
    if (error.name !== "Problem") throw error;
    fill(this.trouble, problemNotice(error));
  }
}

/** Put the text of a field on the clipboard; where the address is not safe, in the way there was before. */
async function copied(input) {
  try {
    await navigator.clipboard.writeText(input.value);
  } catch {
    input.select();
    document.execCommand("copy");
  }
}
