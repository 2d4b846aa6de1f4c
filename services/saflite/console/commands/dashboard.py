"""Show runs in a browser: live figures, what was found, workers, orders.

Takes run folders, a folder that holds runs, or the endpoint of a farm elsewhere (with --campaign). Finds show the map,
the inputs and signals around the violation, and the last good flight beside it. Another address than loopback needs
tokens; nothing is encrypted there, so put it behind a proxy that does, or reach it by `ssh -L`.

examples:
  saflite dashboard runs/avoidance-m2
  saflite dashboard runs --port 8080
  saflite dashboard tls/lab:7447 --campaign night --keys lab2
  saflite dashboard runs/night --host 0.0.0.0 --tokens tokens.txt
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.io import farm_options

if TYPE_CHECKING:
    from saflite.console.view.dashboard.source import Source


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("what", nargs="*", metavar="RUN|ENDPOINT", help="run folders, a folder of runs, or an endpoint")
    parser.add_argument("--campaign", default="", help="its campaign, with an endpoint (the one that runs there)")
    parser.add_argument("--keys", type=Path, metavar="FOLDER", help=farm_options.KEYS)
    parser.add_argument("--insecure", action="store_true", help=farm_options.INSECURE)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at (127.0.0.1)")
    parser.add_argument("--port", type=int, default=8765, help="port to listen at (8765; 0: any that is free)")
    tokens = "file with a token a line, `viewer` before those that may give no orders"
    parser.add_argument("--tokens", type=Path, metavar="FILE", help=tokens)
    arguments.add_modules(parser)


def run(args: argparse.Namespace) -> int:
    """Serve until stopped by the keyboard."""
    from saflite.console.operations import serving
    from saflite.console.view.dashboard import access

    tokens = access.read_tokens(args.tokens) if args.tokens is not None else {}
    access.check_address(args.host, tokens)
    return serving.serve(_sources(args), args.host, args.port, tokens)


def _sources(args: argparse.Namespace) -> list[Source]:
    from saflite.console.operations import serving
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.farm_lookup import Where
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view.dashboard.source import EndpointSource, RunSource
    from saflite.contract.errors import Refused

    words = args.what or [str(farm_lookup.newest(None))]
    if not any(serving.is_endpoint(word) for word in words):
        folders = [folder for word in words for folder in serving.run_folders(Path(word))]
        if len(folders) == 1:  # of several, those that are damaged are listed with the reason
            open_run(folders[0]).close()
        return [RunSource(folder) for folder in folders]
    if len(words) > 1:
        raise Refused("endpoint", expected="one, and no run folder beside it", got=" ".join(words))
    where = Where(None, words[0], args.campaign, args.insecure, args.keys)
    client = farm_lookup.connect(where)
    client.close()
    return [EndpointSource(where._replace(campaign=client.campaign))]
