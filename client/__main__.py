"""Entry point of the `morph` command, also as `python -m client`."""

from __future__ import annotations

from client import interrupt


def main() -> None:
    """Run the command line, Ctrl-C included from its first import on."""
    interrupt.install()
    from client import cli

    cli.main()


if __name__ == "__main__":
    main()
