"""Run the command line as `python -m client`."""

from client.cli import main

main()
