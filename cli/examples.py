"""Examples that stand below the help of each command."""

from __future__ import annotations

from collections.abc import Mapping

EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "run": (
        "morph run cow.obj duck.obj",
        "morph run sphere text:Hi --points-per-cell-edge 2 --set material.youngs_modulus=1",
        "morph run cow.obj duck.obj cow.obj",
        "morph run scan.stl duck.obj --target-rotate 0,90,0",
        "morph run cow.obj duck.obj --out result.vtkhdf --resume",
    ),
    "rerun": ("morph rerun result.vtkhdf --out again.vtkhdf",),
    "methods": ("morph methods",),
    "shapes": ("morph shapes", "morph shapes fetch"),
    "shapes fetch": ("morph shapes fetch --to meshes", "morph shapes fetch cow.obj bunny.obj"),
    "presets": (
        "morph presets",
        "morph presets fast --method joint",
        "morph presets published --describe optimizer",
    ),
    "inspect": ("morph inspect scan.ply", "morph inspect scan.ply --fit none"),
    "metrics": (
        "morph metrics result.vtkhdf",
        "morph metrics result.vtkhdf --path",
        "morph metrics scan.ply cow.obj",
    ),
    "bench": ("morph bench",),
    "reproduce": (
        "morph reproduce",
        "morph reproduce sphere --quick --meshes meshes",
        "morph reproduce all --fetch --jobs 2",
    ),
    "export": (
        "morph export result.vtkhdf -o morph.glb --tracked",
        "morph export result.vtkhdf -o morph.glb --tracked --texture 1024",
        "morph export result.vtkhdf -o frames.ply --fields speed,density",
        "morph export result.vtkhdf -o morph.usdc --surface --snap",
    ),
    "view": ("morph view result.vtkhdf", "morph view result.vtkhdf -o page.html --surface"),
    "render": (
        "morph render result.vtkhdf -o morph.mp4 --surface",
        "morph render result.vtkhdf -o turn.gif --color speed --camera turn --size 640x480",
        "morph render result.vtkhdf -o metal.gif --surface --look metal",
        "morph render result.vtkhdf -o end.png --surface --background transparent",
        "morph render result.vtkhdf -o loop.webm --seconds 3 --fps 30 --repeat loop",
    ),
    "submit": (
        "morph submit cow.obj duck.obj --watch",
        "morph submit sphere torus --name first --priority 10",
    ),
    "jobs": ("morph jobs", "morph jobs --state failed --limit 5"),
    "show": ("morph show JOB",),
    "watch": ("morph watch JOB",),
    "next": ("morph next JOB",),
    "cancel": ("morph cancel JOB",),
    "retry": ("morph retry JOB",),
    "resume": ("morph resume JOB",),
    "delete": ("morph delete JOB",),
    "fetch": ("morph fetch JOB --out result.vtkhdf",),
    "fork": ("morph fork JOB --frame 19 --set material.youngs_modulus=20000 --watch",),
    "queue show": ("morph queue show",),
    "queue pause": ("morph queue pause",),
    "queue unpause": ("morph queue unpause",),
    "sweep": (
        "morph sweep --sources sphere --targets star,torus --methods flow,joint --seeds 1,2",
        "morph sweep SWEEP",
    ),
    "serve": ("morph serve --workers 2", "morph serve --data-dir /srv/morph --port 8000"),
    "worker": ("morph worker --slots 4", "morph worker --gpus all"),
    "doctor": ("morph doctor", "morph doctor --no-compute --json"),
    "backup": ("morph backup /backups/monday",),
    "restore": ("MORPH_DATA_DIR=/srv/other morph restore /backups/monday",),
    "keys list": ("morph keys list",),
    "keys create": ("morph keys create ann --scope read --scope submit",),
    "keys delete": ("morph keys delete ann",),
    "share": ("morph share JOB", "morph share JOB --revoke"),
    "webhooks create": ("morph webhooks create https://example.org/hook --state succeeded",),
    "webhooks list": ("morph webhooks list",),
    "webhooks test": ("morph webhooks test WEBHOOK",),
    "webhooks log": ("morph webhooks log WEBHOOK",),
    "webhooks delete": ("morph webhooks delete WEBHOOK",),
    "workers list": ("morph workers list",),
    "workers pause": ("morph workers pause WORKER",),
    "workers unpause": ("morph workers unpause WORKER",),
}
"""Of each command by its path; JOB and the like stand for what its caller has."""


def epilog(path: str) -> str:
    """What stands below the help of a command, or of a group, which has one of each command.

    The blank lines between its lines are not shown.
    """
    below = (known[0] for name, known in EXAMPLES.items() if name.startswith(f"{path} "))
    examples = EXAMPLES.get(path) or tuple(below)
    heading = "Examples:" if len(examples) > 1 else "Example:"
    return "\n\n".join((heading, *examples)) if examples else ""
