"""A new morph, as a person puts it together."""

from __future__ import annotations

import re

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import expect

from morph_engine.geometry.mesh import load_mesh
from morph_engine.geometry.shapes import make
from morph_engine.methods.flow import FlowOptions
from morph_engine.morphing import prepare
from morph_engine.results.trajectory import Trajectory

pytestmark = pytest.mark.browser


def card(page, label):
    """The part of the form that chooses the source (`From`) or the target (`To`)."""
    return page.get_by_role("region", name=label, exact=True)


def method(page, name):
    """The check mark of a method."""
    return page.get_by_role("checkbox", name=name, exact=True)


def research(page):
    """Open what is folded away: methods, presets, all settings."""
    summary = page.locator("summary").filter(has_text="Research")
    summary.evaluate("one => one.parentElement.open || one.click()")


def make_it_small(page):
    """Few particles and frames, so that the job is quick."""
    research(page)
    page.get_by_label("Particles per cell edge", exact=True).fill("1")
    page.get_by_label("Frames", exact=True).fill("2")
    page.get_by_label("Frames", exact=True).blur()


def test_two_meshes_are_sent_seen_and_morphed(service, mesh_files, page):
    """Two files become particles on the screen, then a job between these meshes that succeeds."""
    run = prepare(mesh_files["ball.obj"], mesh_files["box.stl"])
    counts = len(run.source_points), len(run.target_points)
    page.goto("/new")
    ends = ("From", "source", "ball.obj"), ("To", "target", "box.stl")
    for (label, role, name), count in zip(ends, counts, strict=True):
        card(page, label).get_by_label(f"Mesh file of the {role}").set_input_files(mesh_files[name])
        expect(card(page, label)).to_contain_text(f"{name}:")
        expect(card(page, label).get_by_role("status")).to_have_text(
            re.compile(rf"^{count // 1000}\s{count % 1000:03d} particles$")
        )
        expect(card(page, label).locator("canvas")).to_be_visible()
    make_it_small(page)
    method(page, "physics").check()
    method(page, "flow").uncheck()
    page.get_by_role("button", name="Morph").click()
    page.wait_for_url("**/jobs/*")
    job = service.wait_for(page.url.rpartition("/")[2], "succeeded", "failed")
    assert job["state"] == "succeeded"
    assert (job["source_name"], job["target_name"]) == ("ball.obj", "box.stl")
    assert (job["method"], job["progress"]["frames"]) == ("physics", 2)


def test_a_dropped_file_is_taken(page):
    """A file dropped anywhere on the card is sent."""
    cube = "\n".join(
        [f"v {x} {y} {z}" for x in (-3, 3) for y in (-3, 3) for z in (-3, 3)]
        + ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    )
    page.goto("/new")
    expect(card(page, "To")).to_be_visible()
    files = page.evaluate_handle(
        """text => {
            const data = new DataTransfer();
            data.items.add(new File([text], 'cube.obj'));
            return data;
        }""",
        cube,
    )
    card(page, "To").dispatch_event("drop", {"dataTransfer": files})
    expect(card(page, "To")).to_contain_text("cube.obj: 12 triangles, closed")


def test_files_that_belong_together_are_one_mesh(tmp_path, page):
    """An OBJ with its materials and its picture, chosen together, is seen with its colours."""
    box = trimesh.creation.box(extents=(6, 6, 6))
    picture = Image.new("RGB", (8, 8), (200, 60, 40))
    material = trimesh.visual.material.SimpleMaterial(image=picture)
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2], material=material)
    box.export(tmp_path / "crate.obj")
    files = sorted(tmp_path.iterdir())
    assert {file.suffix for file in files} == {".obj", ".mtl", ".png"}
    page.goto("/new")
    card(page, "From").get_by_label("Mesh file of the source").set_input_files(files)
    expect(card(page, "From")).to_contain_text("crate.zip: 12 triangles, closed, coloured")


def test_a_bad_mesh_is_refused_in_words(mesh_files, page):
    """A sheet without a volume gets a sentence with the cause and one with the remedy."""
    page.goto("/new")
    picker = card(page, "From").get_by_label("Mesh file of the source")
    picker.set_input_files(mesh_files["sheet.obj"])
    alert = card(page, "From").get_by_role("alert").filter(has_text="sheet.obj")
    expect(alert.locator("p")).to_have_count(2)
    assert "source=shape" in page.url, "the shape chosen before stays"
    picker.set_input_files(mesh_files["ball.obj"])
    expect(card(page, "From")).to_contain_text("ball.obj:")
    expect(alert).to_have_count(0)


def test_a_mesh_of_any_size_is_fitted_and_that_can_be_undone(service, mesh_files, page):
    """A pebble far from the origin needs no setting; the page says what was done, and undoes it."""
    page.goto("/new")
    from_card = card(page, "From")
    from_card.get_by_label("Mesh file of the source").set_input_files(mesh_files["pebble.obj"])
    said = page.get_by_text("The source is scaled by")
    expect(said).to_contain_text("your own coordinates")
    expect(from_card.get_by_role("status")).to_contain_text("particles")
    page.get_by_role("button", name="Keep shapes as they are").click()
    expect(said).to_have_count(0)
    fit = page.get_by_label("Fit into the domain", exact=True)
    expect(fit).to_have_value("none")
    expect(page.get_by_text("Shapes keep the size and position")).to_be_visible()
    trouble = from_card.get_by_role("alert").filter(has_text="pebble.obj")
    expect(trouble).to_contain_text("“Fit into the domain”")
    expect(trouble).not_to_contain_text("--")
    expect(from_card.locator("canvas")).to_be_hidden()
    page.get_by_role("button", name="Scale and centre them").click()
    expect(said).to_be_visible()
    expect(fit).to_have_value("auto")
    expect(from_card.locator("canvas")).to_be_visible()
    make_it_small(page)
    page.get_by_role("button", name="Morph").click()
    page.wait_for_url("**/jobs/*")
    job = service.wait_for(page.url.rpartition("/")[2], "succeeded", "failed")
    assert job["state"] == "succeeded"
    page.get_by_role("button", name="Details", exact=True).click()
    expect(page.get_by_role("listitem").filter(has_text="The source is scaled by")).to_be_visible()


@pytest.mark.parametrize(
    ("scale", "suffix"),
    [(0.001, ".glb"), (1.0, ".obj"), (1000.0, ".stl")],
    ids=["mm", "m", "km"],
)
def test_meshes_of_any_unit_come_back_where_they_were(service, page, tmp_path, scale, suffix):
    """Heart to teapot, off-centre, in other units, an STL with z up: only its cost is set.

    The result's maps bring the shapes back to 1e-5 of their size.
    """
    z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    turn = z_up if suffix == ".stl" else np.eye(3)
    ends = {"source": ("From", "heart"), "target": ("To", "teapot")}
    page.goto("/new")
    for role, (label, name) in ends.items():
        shape = make(name)
        vertices = (shape.vertices @ turn.T + [40.0, -90.0, 3.0]) * scale
        path = tmp_path / f"{name}{suffix}"
        more = {"digits": 12} if suffix == ".obj" else {}
        trimesh.Trimesh(vertices, shape.faces, process=False).export(path, **more)
        card(page, label).get_by_label(f"Mesh file of the {role}").set_input_files(path)
        expect(card(page, label)).to_contain_text(f"{path.name}:")
    expect(page.get_by_text("your own coordinates")).to_be_visible()
    make_it_small(page)
    page.get_by_role("button", name="Morph").click()
    page.wait_for_url("**/jobs/*")
    job = service.wait_for(page.url.rpartition("/")[2], "succeeded", "failed")
    assert job["state"] == "succeeded", job["problem"]
    assert job["method"] == "flow"
    assert job["placement"]["up"] == ("z" if suffix == ".stl" else "y")
    result = tmp_path / "r.vtkhdf"
    result.write_bytes(service.call("GET", f"/v1/jobs/{job['id']}/result").content)
    with Trajectory(result) as morph:
        for share, (role, (_, name)) in enumerate(ends.items()):
            mesh = load_mesh(tmp_path / f"{name}{suffix}")
            matrix = morph.run.transform_to("user", float(share))
            back = morph.run.fitted(role)[0].vertices @ matrix[:3, :3].T + matrix[:3, 3]
            size = np.ptp(mesh.bounds, axis=0).max()
            np.testing.assert_allclose(back, mesh.vertices, rtol=0, atol=1e-5 * size)


RECORD = """() => {
    const [card] = document.querySelectorAll(".chooser");
    const cost = document.querySelector(".send p");
    const look = () => {
        const canvas = card.querySelector("canvas");
        const drawn = canvas !== null && getComputedStyle(canvas).visibility !== "hidden";
        return {
            count: card.querySelector(".count").textContent,
            name: card.querySelector("strong")?.textContent ?? "",
            cost: cost.textContent,
            drawn,
        };
    };
    window.seen = [];
    window.recorder?.disconnect();
    window.recorder = new MutationObserver(() => window.seen.push(look()));
    const kinds = ["drop", "input"];
    const begin = () => {
        kinds.forEach((kind) => removeEventListener(kind, begin, true));
        window.recorder.takeRecords();
        [window.before, window.seen] = [look(), []];
    };
    kinds.forEach((kind) => addEventListener(kind, begin, true)); // ahead of the page's own
    const attributeFilter = ["class", "hidden"]; // those of a canvas tell that it is drawn finer
    const options = { subtree: true, childList: true, characterData: true, attributeFilter };
    window.recorder.observe(document.querySelector("form"), options);
    return look();
}"""
"""Keep what the first card and the cost show whenever anything of the form changes.

`window.before` is what they show when a drop or an input begins, `window.seen` what they show
from then on.
"""

NOTHING = {"count": "", "name": "", "cost": "", "drawn": False}


def drop(page, *files):
    """Drop files on the first card, one right after the other."""
    page.evaluate(
        """files => {
            for (const [name, text] of files) {
                const dataTransfer = new DataTransfer();
                dataTransfer.items.add(new File([text], name));
                const options = { dataTransfer, bubbles: true, cancelable: true };
                document.querySelector(".chooser").dispatchEvent(new DragEvent("drop", options));
            }
        }""",
        [[file.name, file.read_text()] for file in files],
    )


def wait_for_particles(page):
    """Until the first card shows what is chosen, and what it costs if it is a mesh."""
    expect(card(page, "From").locator(".count")).to_have_text(re.compile("particles$"))
    expect(card(page, "From").locator("canvas")).to_be_visible()


def test_what_is_shown_is_what_is_chosen(mesh_files, page):
    """At every moment: a bad file after a good one, another kind, a word typed, two fast drops.

    Whatever is done, particles, their number, the mesh and the time that were shown before are
    never seen after it.
    """
    ball, sheet, pebble = (mesh_files[f"{name}.obj"] for name in ("ball", "sheet", "pebble"))
    crate = mesh_files["crate.obj"]
    from_card = card(page, "From")

    def act(do, settle):
        """What is shown from an action until it has settled, and what was shown before."""
        page.evaluate(RECORD)
        do()
        settle()
        before, seen = page.evaluate("[window.before, window.seen]")
        assert seen
        for now in seen:
            for part in ("count", "name", "cost"):
                assert now[part] != before[part] or not now[part], f"{part}: {now}"
        assert not seen[0]["drawn"]
        return seen

    def good(file):
        drop(page, file)
        expect(from_card).to_contain_text(f"{file.name}:")
        wait_for_particles(page)
        expect(page.get_by_text("Usually takes about")).to_be_visible()

    page.goto("/new")
    wait_for_particles(page)
    good(ball)
    refused = from_card.get_by_role("alert").filter(has_text="sheet.obj")
    seen = act(lambda: drop(page, sheet), refused.wait_for)
    assert seen[-1] == NOTHING
    page.get_by_label("Duration").fill("7")
    page.get_by_label("Duration").blur()
    expect(page.get_by_text("1 setting changed")).to_be_attached()
    assert page.evaluate(RECORD) == NOTHING, "another setting does not bring it back"
    page.get_by_role("button", name="Morph").click()
    expect(from_card.get_by_role("alert")).to_contain_text("Choose another mesh file")
    good(ball)
    act(from_card.get_by_role("radio", name="Text").check, lambda: None)
    assert page.evaluate(RECORD) == NOTHING
    word = from_card.get_by_role("textbox", name="Text")
    act(lambda: word.press_sequentially("A"), lambda: wait_for_particles(page))
    seen = act(lambda: word.press("Backspace"), lambda: None)
    assert seen[-1] == NOTHING
    word.press_sequentially("B")
    wait_for_particles(page)
    word.blur()
    act(from_card.get_by_role("radio", name="Built-in").check, lambda: wait_for_particles(page))
    good(ball)
    names = from_card.locator("strong")
    seen = act(lambda: drop(page, sheet, pebble), lambda: expect(names).to_have_text("pebble.obj"))
    expect(refused).to_have_count(0)
    wait_for_particles(page)
    seen = act(lambda: drop(page, crate, ball), lambda: expect(names).to_have_text("ball.obj"))
    assert {now["name"] for now in seen} == {"", "ball.obj"}


def test_a_mesh_sent_before_and_a_text_can_be_chosen(service, mesh_files, page):
    """Uploads are kept by the service; any text that a font can write becomes solid letters."""
    ball = mesh_files["ball.obj"]
    service.call("POST", "/v1/meshes?name=ball.obj", content=ball.read_bytes())
    page.goto("/new")
    card(page, "From").get_by_role("radio", name="Mesh file").check()
    card(page, "From").get_by_label("Or a mesh uploaded before").select_option("ball.obj")
    expect(card(page, "From")).to_contain_text("ball.obj:")
    chosen = page.url
    card(page, "From").get_by_role("radio", name="Built-in").check()
    page.wait_for_url(re.compile("source=shape"))
    card(page, "From").get_by_role("radio", name="Mesh file").check()
    page.wait_for_url(chosen)
    card(page, "To").get_by_role("radio", name="Text").check()
    word = card(page, "To").get_by_role("textbox", name="Text")
    word.fill(" ")
    word.blur()
    expect(card(page, "To")).to_contain_text("Enter at least one character")
    word.fill("\ue8ff")
    expect(card(page, "To")).to_contain_text("No installed font has the character")
    word.fill("½ Ωμέγα & é/#?")
    with page.expect_response(re.compile(r"/v1/shapes/text%3A.*/particles")) as sampled:
        word.blur()
    assert sampled.value.ok
    wait_for_particles(page)


def test_changed_settings_alone_are_sent(service, page):
    """A setting found by its name, changed, kept over a reload, and sent as the only override."""
    page.goto("/new?preset=published&methods=joint")
    make_it_small(page)
    page.get_by_text("All settings").click()
    page.get_by_label("Find a setting").fill("huber")
    huber = page.get_by_label("Huber delta", exact=True)
    expect(huber).to_have_value("1.5")
    expect(page.get_by_label("Youngs modulus", exact=True)).to_be_hidden()
    huber.fill("0.75")
    huber.blur()
    expect(page.get_by_text("3 settings changed")).to_be_visible()

    page.reload()
    expect(page.get_by_text("3 settings changed")).to_be_visible()
    with page.expect_request(re.compile("/v1/jobs$")) as sent:
        page.get_by_role("button", name="Morph").click()
    page.wait_for_url("**/jobs/*")
    assert sent.value.post_data_json["overrides"] == {
        "frames": 2,
        "sampling.points_per_cell_edge": 1,
        "chamfer.huber_delta": 0.75,
    }
    job = page.url.rpartition("/")[2]
    service.call("POST", f"/v1/jobs/{job}/cancel")
    config = service.call("GET", f"/v1/jobs/{job}/config").json()
    assert config["method"]["chamfer"]["huber_delta"] == 0.75


def test_settings_are_those_of_the_chosen_methods(service, page):
    """A method's settings come and go with it; a change that it does not have is not sent."""
    page.goto("/new")
    research(page)
    page.get_by_text("All settings").click()
    weight, memory = page.locator("[id='set-chamfer.weight']"), page.locator("[id='set-memory']")
    expect(memory).to_have_value(f"{FlowOptions().memory:g}")
    expect(weight).to_be_hidden()
    memory.fill("3")
    memory.blur()
    expect(page.get_by_text("1 setting changed")).to_be_visible()
    method(page, "joint").check()
    expect(weight).to_have_value("10")
    expect(memory).to_be_visible()
    method(page, "flow").uncheck()
    expect(memory).to_be_hidden()
    expect(page.get_by_text("1 setting changed")).to_be_hidden()
    with page.expect_request(re.compile("/v1/jobs$")) as sent:
        page.get_by_role("button", name="Morph").click()
    assert sent.value.post_data_json["overrides"] == {}
    page.wait_for_url("**/jobs/*")
    # others need the worker
    service.call("POST", f"/v1/jobs/{page.url.rpartition('/')[2]}/cancel")


def test_an_artist_sees_no_jargon(page):
    """Matter and fineness are words; methods and settings are folded away, and stay as left."""
    page.goto("/new")
    expect(method(page, "flow")).to_be_hidden()
    expect(page.get_by_label("Preset", exact=True)).to_be_hidden()
    page.get_by_label("Matter").select_option("fluid")
    page.get_by_label("Fineness").select_option("2")
    page.route("**/v1/jobs", lambda route: route.abort())
    with page.expect_request(re.compile("/v1/jobs$")) as sent:
        page.get_by_role("button", name="Morph").click()
    body = sent.value.post_data_json
    assert (body["preset"], body["method"]) == ("fluid", "flow")
    assert body["overrides"] == {"sampling.points_per_cell_edge": 2}
    research(page)
    expect(page.get_by_label("Preset", exact=True)).to_have_value("fluid")
    edge = page.get_by_label("Particles per cell edge", exact=True)
    edge.fill("1")
    edge.blur()
    page.get_by_label("Preset", exact=True).select_option("published")
    expect(page.get_by_label("Fineness")).to_have_value("")
    expect(page.get_by_label("Matter")).to_have_value("")
    page.goto("/new")
    expect(method(page, "flow")).to_be_visible()
    page.get_by_text("Research", exact=True).click()
    page.goto("/new?methods=joint")
    expect(method(page, "joint")).to_be_checked()
    expect(method(page, "joint")).to_be_visible()
    expect(page.get_by_label("Matter")).to_be_hidden()


def test_an_unfinished_choice_is_not_sent(page):
    """Where a kind of shape is chosen and no shape, nothing is morphed in its place."""
    sent = []
    page.on("request", lambda request: sent.append(request.method))
    page.goto("/new")
    morph = page.get_by_role("button", name="Morph")
    card(page, "From").get_by_role("radio", name="Mesh file").check()
    morph.click()
    expect(card(page, "From").get_by_role("alert")).to_contain_text("Choose a mesh file")
    expect(card(page, "From").get_by_label("Mesh file of the source")).to_be_focused()
    card(page, "From").get_by_role("radio", name="Built-in").check()
    card(page, "To").get_by_role("radio", name="Text").check()
    card(page, "To").get_by_role("textbox", name="Text").fill("  ")
    morph.click()
    expect(card(page, "To").get_by_role("textbox", name="Text")).to_be_focused()
    assert "POST" not in sent


def test_a_newer_choice_outlives_an_upload(mesh_files, page):
    """A mesh that arrives late does not replace what was chosen meanwhile."""
    held = []
    page.route(re.compile("/v1/meshes\\?name"), lambda route: held.append(route))
    page.goto("/new")
    card(page, "From").get_by_label("Mesh file of the source").set_input_files(
        mesh_files["ball.obj"]
    )
    expect(card(page, "From").get_by_role("progressbar")).to_be_visible()
    card(page, "From").get_by_role("radio", name="Built-in").check()
    card(page, "From").get_by_role("radio", name="torus").check()
    expect(card(page, "From").get_by_role("progressbar")).to_have_count(0)
    assert len(held) == 1
    page.wait_for_url(re.compile("source=shape(:|%3A)torus"))
    expect(card(page, "From").get_by_role("radio", name="torus")).to_be_checked()


def test_what_is_being_typed_stays(page):
    """A preset that arrives late fills every field but the one somebody types in."""
    held = []
    page.route("**/v1/presets/published?*", lambda route: held.append(route))
    page.goto("/new")
    research(page)
    with page.expect_request("**/v1/presets/published?*"):
        page.get_by_label("Preset", exact=True).select_option("published")
    frames = page.get_by_label("Frames", exact=True)
    frames.select_text()
    frames.press_sequentially("1")
    held[0].continue_()
    expect(page.get_by_text("number for number")).to_be_visible()
    frames.press_sequentially("2")
    expect(frames).to_have_value("12")
    frames.blur()
    expect(page.get_by_text("1 setting changed")).to_be_visible()


def test_a_value_out_of_range_is_told_beside_its_field(page):
    """Nothing is sent while a value is out of range, and the field that is wrong gets the focus."""
    sent = []
    page.on("request", lambda request: request.method == "POST" and sent.append(request.url))
    page.goto("/new")
    research(page)
    frames = page.get_by_label("Frames", exact=True)
    frames.fill("0")
    frames.blur()
    expect(page.get_by_text("Enter a whole number from 1 to 10000.")).to_be_visible()
    page.get_by_role("button", name="Morph").click()
    expect(frames).to_be_focused()
    assert sent == []
    page.get_by_label("Name", exact=True).fill("named meanwhile")
    page.get_by_label("Name", exact=True).blur()
    expect(page).to_have_url(re.compile("name=named"))
    expect(frames).to_have_value("0")
    frames.fill("7")
    frames.blur()
    expect(page.get_by_text("Enter a whole number from 1 to 10000.")).to_have_count(0)
    expect(page).to_have_url(re.compile("frames%22%3A7"))


def test_half_a_number_is_told_where_none_is_needed(page):
    """It is not taken for an empty field."""
    page.goto("/new")
    research(page)
    page.get_by_text("All settings").click()
    tension = page.locator("[id='set-tension']")
    tension.press_sequentially("1e")
    tension.blur()
    expect(page.locator("[id='set-tension-fault']")).to_contain_text("Enter a number")


def test_a_morph_lasts_as_many_seconds_as_asked(page):
    """At twelve frames a second, all legs together; what cannot be is told and not sent."""
    page.goto("/new?source=shape:sphere&target=shape:sphere&via=shape:torus")
    lasts = page.get_by_label("Duration")
    expect(lasts).to_have_value("6.67")
    expect(page.get_by_label("Frames", exact=True)).to_be_hidden()
    lasts.fill("-1")
    page.get_by_role("button", name="Morph").click()
    expect(page.get_by_text("Enter a number of seconds above 0 and at most 1666.")).to_be_visible()
    expect(lasts).to_be_focused()
    lasts.fill("5")
    lasts.blur()
    expect(page).to_have_url(re.compile("frames%22%3A30%7D"))
    page.route("**/v1/jobs", lambda route: route.abort())
    with page.expect_request(re.compile("/v1/jobs$")) as sent:
        page.get_by_role("button", name="Morph").click()
    assert sent.value.post_data_json["overrides"] == {"frames": 30}
    research(page)
    expect(page.get_by_label("Frames", exact=True)).to_have_value("30")


def test_what_lasts_ten_times_as_long_is_ready_later(mesh_files, page):
    """The form says when, for the length chosen."""
    page.goto("/new")
    card(page, "From").get_by_label("Mesh file of the source").set_input_files(
        mesh_files["ball.obj"]
    )
    cost = page.get_by_text("Usually takes about")

    def seconds():
        minutes, rest = re.search(
            r"about (?:(\d+) min)? ?(?:(\d+) s)?", cost.text_content()
        ).groups()
        return 60 * int(minutes or 0) + int(rest or 0)

    expect(cost).to_be_visible()
    usual, words = seconds(), cost.text_content()
    page.get_by_label("Duration").fill("33.3")
    page.get_by_label("Duration").blur()
    expect(cost).not_to_have_text(words)
    assert seconds() == pytest.approx(10 * usual, rel=0.15)


def test_messages_call_settings_as_the_form_does(page):
    """Whether they have a field of their own or stand under a heading, and never by a path."""
    page.goto('/new?overrides={"grid.dx":8}')
    page.get_by_role("button", name="Morph").click()
    told = page.get_by_role("alert").filter(has_text="fewer than 500")
    expect(told).to_contain_text("Raise “Particles per cell edge”, or lower “Dx” under “Grid”.")
    expect(told.locator("code")).to_have_count(0)


def test_what_only_the_service_refuses_is_told_beside_its_field(page):
    """An address can ask for what the form would not take; the service's words are shown."""
    page.goto('/new?methods=joint&overrides={"chamfer.weight":-3}')
    page.get_by_role("button", name="Morph").click()
    fault = page.locator("[id='set-chamfer.weight-fault']")
    expect(fault).to_contain_text("-3: input should be greater than or equal to 0")
    expect(page.locator("[id='set-chamfer.weight']")).to_be_focused()


def test_a_morph_goes_through_several_shapes(service, mesh_files, page):
    """Shapes between are added and removed, live in the address, and make one job of three legs."""
    page.goto("/new?source=shape:sphere&target=shape:sphere")
    add = page.get_by_role("button", name="Add a shape in between")
    for _ in range(3):
        add.click()
    between = card(page, "Through (2)")
    between.get_by_label("Mesh file of the shape number 3").set_input_files(mesh_files["box.stl"])
    expect(between).to_contain_text("box.stl:")
    page.get_by_role("button", name="Remove shape number 4").click()
    expect(card(page, "Through (3)")).to_have_count(0)
    page.reload()
    expect(card(page, "Through (2)")).to_contain_text("box.stl:")
    make_it_small(page)
    method(page, "dco").check()
    page.get_by_role("button", name="Morph").click()
    expect(page.get_by_role("alert").filter(has_text="can use only one method")).to_be_visible()
    method(page, "flow").uncheck()
    page.get_by_role("button", name="Morph").click()
    page.wait_for_url("**/jobs/*")
    job = service.wait_for(page.url.rpartition("/")[2], "succeeded", "failed")
    assert job["state"] == "succeeded", job["problem"]
    assert job["via_names"] == ["torus", "box.stl"]
    assert job["progress"]["frames"] == 6
    heading = page.get_by_role("heading", name="sphere → torus → box.stl → sphere")
    expect(heading).to_be_visible()
    for frame, leg in ((1, 0), (3, 1), (6, 2)):
        page.goto(f"/jobs/{job['id']}?frame={frame}")
        with page.expect_response(re.compile(rf"/target\?leg={leg}&")) as answer:
            page.get_by_label("Target", exact=True).select_option("cloud")
        assert answer.value.status == 200
        page.get_by_label("Target", exact=True).select_option("none")
    page.goto(f"/new?like={job['id']}")
    expect(card(page, "Through (2)")).to_contain_text("box.stl:")


def test_the_shape_between_that_is_removed_goes(page):
    """Not the last one: what is not chosen yet goes with it, and the morph can be sent."""
    page.goto("/new")
    add = page.get_by_role("button", name="Add a shape in between")
    add.click()
    add.click()
    card(page, "Through (2)").get_by_role("radio", name="heart").check()
    card(page, "Through (1)").get_by_role("radio", name="Mesh file").check()
    page.get_by_role("button", name="Remove shape number 2").click()
    expect(add).to_be_focused()
    expect(card(page, "Through (2)")).to_have_count(0)
    expect(card(page, "Through (1)").get_by_role("radio", name="heart")).to_be_checked()
    page.route("**/v1/jobs", lambda route: route.abort())
    with page.expect_request("**/v1/jobs") as sent:
        page.get_by_role("button", name="Morph", exact=True).click()
    assert sent.value.post_data_json["via"] == [{"shape": "heart"}]


def test_an_address_that_stays_keeps_nobody_from_going_on(page):
    """Safari takes few changes of the address in a while."""
    refuse = "throw new DOMException('too many', 'SecurityError')"
    page.add_init_script(f"history.replaceState = () => {{ {refuse}; }};")
    page.goto("/new")
    card(page, "To").get_by_role("radio", name="torus").check()
    page.route("**/v1/jobs", lambda route: route.abort())
    with page.expect_request("**/v1/jobs") as sent:
        page.get_by_role("button", name="Morph", exact=True).click()
    assert sent.value.post_data_json["target"] == {"shape": "torus"}


def test_several_methods_make_a_sweep_once(service, page):
    """Two methods and a double click are two jobs, listed as one sweep."""
    page.goto("/new?methods=physics,dco")
    make_it_small(page)
    page.get_by_role("button", name="Morph with 2 methods").dblclick()
    page.wait_for_url("**/?sweep=*")
    sweep = page.url.rpartition("=")[2]
    expect(page.get_by_role("row").filter(has_text="sphere → star")).to_have_count(2)
    rows = service.call("GET", f"/v1/sweeps/{sweep}").json()["rows"]
    assert sorted(row["method"] for row in rows) == ["dco", "physics"]
    for row in rows:
        service.call("POST", f"/v1/jobs/{row['job']}/cancel")


def test_a_job_is_changed_and_run_again(service, page):
    """The form takes over a job's shapes, method and settings."""
    job = service.submit(
        name="to be changed",
        target={"shape": "torus"},
        method="dcd",
        overrides={"sampling.points_per_cell_edge": 1, "density.neighbors": 5},
    )
    service.call("POST", f"/v1/jobs/{job}/cancel")
    page.goto("/")
    page.get_by_role("link", name="Change to be changed and run it again").click()
    expect(page.get_by_label("Name", exact=True)).to_have_value("to be changed")
    expect(card(page, "To").get_by_label("torus")).to_be_checked()
    expect(method(page, "dcd")).to_be_checked()
    expect(page.get_by_label("Frames", exact=True)).to_have_value("3")
    page.get_by_text("All settings").click()
    expect(page.locator("[id='set-neighbors']")).to_have_value("5")


def test_a_morph_with_the_keyboard_alone(service, page):
    """From the list to a running job by Tab, arrows, Space and Enter."""
    page.goto("/")
    page.get_by_role("link", name="New morph").first.focus()
    page.keyboard.press("Enter")
    expect(card(page, "From").get_by_label("sphere")).to_be_checked()

    def tab_to(target):
        for _ in range(60):
            if target.evaluate("element => element === document.activeElement"):
                return
            page.keyboard.press("Tab")
        pytest.fail(f"Tab does not reach {target}.")

    tab_to(card(page, "From").get_by_label("sphere"))
    page.keyboard.press("ArrowRight")
    expect(card(page, "From").get_by_label("torus")).to_be_checked()
    tab_to(page.get_by_label("Duration"))
    page.keyboard.press("ControlOrMeta+A")
    page.keyboard.type("0.2")
    tab_to(page.get_by_label("Name", exact=True))
    page.keyboard.type("typed")
    tab_to(page.locator("summary").filter(has_text="Research"))
    page.keyboard.press("Space")
    tab_to(method(page, "flow"))
    tab_to(method(page, "dco"))
    page.keyboard.press("Space")
    tab_to(page.get_by_label("Particles per cell edge", exact=True))
    page.keyboard.press("ControlOrMeta+A")
    page.keyboard.type("1")
    page.keyboard.press("Enter")
    page.wait_for_url("**/?sweep=*")
    expect(page.get_by_role("link", name="typed", exact=True)).to_have_count(2)
    jobs = service.call("GET", f"/v1/sweeps/{page.url.rpartition('=')[2]}").json()["rows"]
    assert {job["source"] for job in jobs} == {"torus"}
    for job in jobs:
        service.call("POST", f"/v1/jobs/{job['job']}/cancel")
