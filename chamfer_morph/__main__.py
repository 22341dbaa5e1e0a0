"""The `morph` command as `python -m chamfer_morph`."""

from chamfer_morph.cli.__main__ import main

main()
