/** How an exported video is drawn: its size, what things are made of, what is behind them, where the eye is. */
import { choice, offer } from "../../choice.js";
import { fill, h } from "../../dom.js";
import { percent } from "../../format.js";
import { LOOKS } from "../../viewer/looks.js";

const SIZES = [
  ["1280x720", "1280 × 720"],
  ["1920x1080", "1920 × 1080"],
  ["3840x2160", "3840 × 2160"],
  ["1080x1080", "1080 × 1080"],
  ["1080x1920", "1080 × 1920"],
];
const BACKGROUNDS = [
  ["white", "White"],
  ["black", "Black"],
  ["transparent", "Transparent"],
  ["own", "Custom colour"],
];
const CAMERAS = [
  ["still", "Still"],
  ["turn", "Once around"],
  ["orbit", "Around, up and down"],
  ["keys", "Along a path"],
];

export class PictureOptions {
  #keys = [];

  /**
   * @param {object} options
   * @param {import("../../viewer/panel.js").Panel} options.panel
   * @param {() => number} options.share of the run that is shown, 0..1.
   */
  constructor({ panel, share }) {
    Object.assign(this, { panel, share });
    const change = () => this.#reflect();
    const looks = Object.entries(LOOKS).map(([name, { label }]) => [name, label]);
    this.size = choice("picture-size", "Pixels", SIZES);
    this.look = choice("picture-look", "Material", [["shown", "As shown"], ["", "Plain"], ...looks]);
    this.background = choice("picture-background", "Background", BACKGROUNDS, { change });
    this.colour = h("input", { type: "color", value: "#1e2a38", "aria-label": "Colour of the background" });
    this.camera = choice("picture-camera", "Camera", CAMERAS, { change });
    this.list = h("ol", { class: "camera-keys small" });
    const add = async () => this.#add(await this.panel.viewer);
    this.places = h(
      "div",
      { class: "stack" },
      h("p", { class: "small quiet" }, "Go to a frame, turn the view, and add the position; the camera moves smoothly through all of them."),
      this.list,
      h("div", { class: "row" }, h("button", { type: "button", class: "compact", on: { click: add } }, "Add this position")),
    );
    this.element = h(
      "fieldset",
      { class: "stack picture-options" },
      h("legend", { class: "visually-hidden" }, "Picture"),
      h("div", { class: "row" }, this.size.field, this.look.field, this.background.field, this.colour, this.camera.field),
      this.places,
    );
    this.#reflect();
  }

  /** @param {string[]} carries what the format can hold, see /v1/exports/formats. */
  offer(carries) {
    this.element.hidden = !carries.includes("picture");
    offer(this.background.select, (name) => name !== "transparent" || carries.includes("transparency"));
    this.#reflect();
  }

  /** @returns {object} as a request of an export has it. */
  get request() {
    const [width, height] = this.size.select.value.split("x").map(Number);
    const look = this.look.select.value === "shown" ? this.panel.display.look : this.look.select.value;
    const background = this.background.select.value === "own" ? this.colour.value : this.background.select.value;
    const camera = this.camera.select.value;
    const eye = camera === "keys" ? { camera_keys: this.#keys } : { camera };
    return { width, height, background, ...(look && { look }), ...eye };
  }

  #add(viewer) {
    if (!viewer) return;
    const share = this.share();
    this.#keys = [...this.#keys.filter((key) => key.share !== share), { share, ...viewer.eye }];
    this.#keys.sort((one, other) => one.share - other.share);
    this.#showKeys();
  }

  #showKeys() {
    fill(
      this.list,
      this.#keys.map((key) => {
        const remove = () => {
          this.#keys = this.#keys.filter((one) => one !== key);
          this.#showKeys();
        };
        const { share, azimuth, elevation, zoom } = key;
        const words = `${percent(share)}: ${Math.round(azimuth)}° around, ${Math.round(elevation)}° high, × ${zoom.toFixed(1)}`;
        return h(
          "li",
          null,
          words,
          " ",
          h("button", { type: "button", class: "compact", "aria-label": `Remove the position at ${percent(share)}`, on: { click: remove } }, "Remove"),
        );
      }),
    );
  }

  #reflect() {
    this.colour.hidden = this.background.select.value !== "own";
    this.places.hidden = this.camera.select.value !== "keys";
  }
}
