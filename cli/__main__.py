"""Entry point of the `morph` command, also as `python -m chamfer_morph`."""

from __future__ import annotations

from chamfer_morph.cli import interrupt


def main() -> None:
    """Run the command line, Ctrl-C included from its first import on."""
    interrupt.install()
    from chamfer_morph.cli import app

    app.main()


if __name__ == "__main__":
    main()
