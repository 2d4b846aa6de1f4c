"""Print the JSON Schema of a message, of campaign or policy files, or the topic table.

examples:
  saflite schema                 what there is
  saflite schema campaign        the schema of a campaign file (point your editor at it)
  saflite schema policy          that of a policy file
  saflite schema Violation
  saflite schema topics
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument(
        "name", nargs="?", default="", help="a message, `campaign`, `policy` or `topics`; nothing: list them"
    )
    parser.add_argument("--json", action="store_true", help="list as JSON")


def run(args: argparse.Namespace) -> int:
    """Print what was asked for."""
    from saflite.console.io import editor_schemas, schemas
    from saflite.console.view import out
    from saflite.contract.errors import Refused

    kinds = schemas.messages()
    if not args.name:
        names = ["campaign", "policy", "topics", *kinds]
        out.json(names) if args.json else out.line("\n".join(names))
        return 0
    if args.name == "topics":
        out.line(schemas.topics_table())
        return 0
    files = {"campaign": editor_schemas.campaign_schema, "policy": editor_schemas.policy_schema}
    if args.name in files:
        out.line(files[args.name]().rstrip())
        return 0
    kind = kinds.get(args.name)
    if kind is None:
        raise Refused("schema", expected=f"campaign, policy, topics or one of {', '.join(kinds)}", got=repr(args.name))
    out.line(schemas.schema_text(kind).rstrip())
    return 0
