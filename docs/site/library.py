"""The reference of the library and the client, a page a subject, from their docstrings."""

from __future__ import annotations

PAGES = {
    "Morphs": (
        "A morph from shapes to frames: all of it that most programs need.",
        ("morph_engine.morphing", "morph_engine.presets", "morph_engine.config.settings"),
    ),
    "Shapes": (
        "What is morphed: meshes, built-in shapes, words, and the particles that fill them.",
        (
            "morph_engine.geometry.mesh",
            "morph_engine.geometry.shapes",
            "morph_engine.ingest",
            "morph_engine.geometry.sampling",
        ),
    ),
    "Results": (
        "Result files, the fields of their particles, and what programs read from them.",
        (
            "morph_engine.results.trajectory",
            "morph_engine.results.selection",
            "morph_engine.results.fields",
            "morph_engine.export",
        ),
    ),
    "Pictures and surfaces": (
        "Pictures and videos without a display, and the closed surface around particles.",
        (
            "morph_engine.rendering.pictures",
            "morph_engine.geometry.surface_reconstruction",
            "morph_engine.geometry.surface_snapping",
        ),
    ),
    "Metrics": (
        "Any two shapes measured, and a run along its path. [Metrics](../../metrics.md) tells what "
        "the numbers mean.",
        (
            "morph_engine.comparison",
            "morph_engine.metrics.definitions",
            "morph_engine.metrics.path",
            "morph_engine.metrics.independent",
        ),
    ),
    "Methods": (
        "What a method has to offer, to be called by its name: "
        "[a method of your own](../../own_method.md).",
        (
            "morph_engine.methods.method",
            "morph_engine.methods.options",
            "morph_engine.methods.registry",
            "morph_engine.cost",
        ),
    ),
    "Client": (
        "The service from Python; [using the service](../../client.md) shows how.",
        (
            "chamfer_morph.client.client",
            "chamfer_morph.client.operations",
            "chamfer_morph.client.errors",
        ),
    ),
    "Errors": (
        "Everything that a user can mend is one of these, with its cause and its remedy.",
        ("morph_engine.errors",),
    ),
}
"""What each page says first, and the modules it documents."""


def pages() -> dict[str, str]:
    """The pages by their names."""
    return {
        f"reference/python/{title.lower().replace(' ', '_')}": "\n\n".join(
            (f"# Python: {title[0].lower()}{title[1:]}", introduction, *map(_module, modules))
        )
        for title, (introduction, modules) in PAGES.items()
    }


def _module(name: str) -> str:
    """A section with everything public in a module."""
    return f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```"
