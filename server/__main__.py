"""Processes of the server: `python -m chamfer_morph.server api|serve|check|openapi|keys`."""

from __future__ import annotations

import argparse
import json
import logging
import os
import socket
import sys
import tempfile
from typing import TYPE_CHECKING

from chamfer_morph.worker import service_log, telemetry
from chamfer_morph.worker.private_process import keep_private
from chamfer_morph.worker.settings import Settings, load_settings
from morph_engine.errors import MorphError

if TYPE_CHECKING:
    from chamfer_morph.server.database.api_keys import ApiKeyStore

BAD_INPUT = 2


def main() -> None:
    """Run one process until it is told to end."""
    arguments = _parser().parse_args()
    keep_private()
    logging.getLogger("python_multipart").setLevel(logging.ERROR)  # strangers' forms are no news
    try:
        settings = load_settings()
        service_log.set_up(settings.log_format)
        sys.exit(_run(arguments, settings))
    except MorphError as error:
        sys.stderr.write(f"{error.cause}\n{error.remedy}\n")
        sys.exit(BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m chamfer_morph.server", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    api = commands.add_parser("api", help="answer requests")
    api.add_argument("--fd", type=int, help="file descriptor of the listening socket to use")
    commands.add_parser("serve", help="API, workers and janitor on this machine")
    commands.add_parser("check", help="create the tables and check the configuration")
    commands.add_parser("openapi", help="print the OpenAPI description of the API")
    keys = commands.add_parser("keys", help="make and revoke API keys")
    actions = keys.add_subparsers(dest="action", required=True)
    add = actions.add_parser("add", help="make a key and print its secret")
    add.add_argument("name")
    add.add_argument(
        "--scope",
        action="append",
        choices=["read", "submit", "admin"],
        help="may be given several times; default: read and submit",
    )
    actions.add_parser("list", help="print the keys as JSON")
    remove = actions.add_parser("remove", help="revoke a key")
    remove.add_argument("name")
    return parser


def _run(arguments: argparse.Namespace, settings: Settings) -> int:
    if arguments.command == "serve":
        from chamfer_morph.server.serve import serve

        return serve(settings)
    if arguments.command == "openapi":
        from chamfer_morph.server.app import create_app
        from chamfer_morph.server.http.openapi import text

        sys.stdout.write(text(create_app(settings)))
        return 0
    api_keys = _api_keys(settings)
    if arguments.command == "keys":
        return _manage_keys(arguments, api_keys)
    from chamfer_morph.server.auth import check_keys
    from chamfer_morph.worker.storage import open_storage

    if secret := settings.read_admin_key():
        api_keys.put("admin", "admin", secret)
    check_keys(settings, api_keys)
    if arguments.command == "check":
        from chamfer_morph.worker.dbos_adapter import migrate

        migrate(settings)
        if settings.object_store:
            open_storage(settings, "api").probe_store()
    else:
        from chamfer_morph.server.api_server import ApiServer
        from chamfer_morph.server.http.connection_limits import allow_many_files
        from chamfer_morph.server.listener import listen

        allow_many_files()
        telemetry.set_up("morph-api")
        # parts of forms lie beside the meshes on their way in, for /tmp may be memory
        tempfile.tempdir = str(open_storage(settings, "api").uploads)
        inherited = arguments.fd is not None
        listener = socket.socket(fileno=arguments.fd) if inherited else listen(settings)
        ApiServer(settings).run(sockets=[listener])
    return 0


def _api_keys(settings: Settings) -> ApiKeyStore:
    """The keys, in tables that exist."""
    from chamfer_morph.server.database.api_keys import ApiKeyStore
    from chamfer_morph.server.database.tables import create
    from chamfer_morph.worker.dbos_adapter import check_reachable, database
    from chamfer_morph.worker.layout import check_layout
    from chamfer_morph.worker.storage import Storage

    Storage(settings.data_dir)
    check_reachable(settings)
    check_layout(settings)
    engine = database(settings)
    create(engine)
    return ApiKeyStore(engine)


def _manage_keys(arguments: argparse.Namespace, api_keys: ApiKeyStore) -> int:
    if arguments.action == "list":
        keys = [key.model_dump(mode="json") for key in api_keys.all()]
        sys.stdout.write(json.dumps(keys, indent=2) + "\n")
        return 0
    if arguments.action == "remove":
        if api_keys.remove(arguments.name):
            path = f"/v1/keys/{arguments.name}"
            service_log.log_change("command", "revokeKey", path=path)
            return 0
        sys.stderr.write(f"There is no key {arguments.name!r}.\n")
        return BAD_INPUT
    from pydantic import ValidationError

    from chamfer_morph.schemas import KeyRequest

    try:
        request = KeyRequest(name=arguments.name, scopes=arguments.scope or ["read", "submit"])
    except ValidationError:
        sys.stderr.write(
            "The name of a key consists of at most 64 letters, digits, dots, dashes and "
            "underscores.\n"
        )
        return BAD_INPUT
    made = api_keys.add(request.name, request.scopes)
    if made is None:
        sys.stderr.write(f"A key {request.name!r} already exists.\n")
        return BAD_INPUT
    key, secret = made
    path = f"/v1/keys/{key.name}"
    service_log.log_change("command", "makeKey", path=path, scopes=key.scopes)
    sys.stdout.write(f"{secret}{os.linesep}")
    return 0


if __name__ == "__main__":
    main()
