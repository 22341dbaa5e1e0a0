"""What `blender --command extension validate` does, by the function that Blender has for it.

Run in Blender by `test_addon.py` with a zip; prints JSON.
"""

import json
import sys
from importlib import import_module

import bpy


def main(extension):
    """Exit status of the command."""
    bpy.ops.preferences.addon_enable(module="bl_pkg")
    command = import_module("bl_pkg.bl_extension_cli")
    status = command.cli_extension_handler(["validate", extension])
    sys.stdout.write(f"FOUND {json.dumps({'status': status})}\n")


main(sys.argv[1])
