"""Put a scorer model to the paper's two questions.

logs: are flight logs (.ulg, .bin, .mcap, extracts of .ulg as .csv) interesting? Told as text and judged; with labels,
all figures of table II, beside those of the constant answers.
bugs: among all inputs of a policy's published list, does the model find the one that triggers the known bug?

examples:
  saflite evaluate logs flights/ --labels labels.csv --model ollama:mistral
  saflite evaluate bugs --model relevance --plot bugs.svg
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import arguments, outputs


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="logs|bugs")
    logs = kinds.add_parser("logs", help="RQ1: interesting logs")
    logs.add_argument("folder", type=Path, help="folder with flight logs (searched below, too)")
    logs.add_argument(
        "--labels",
        type=Path,
        help="CSV with columns log (file name, its start or a part of it) and interesting (yes, no, unclear), or with "
        "log_id and shows_issue",
    )
    logs.add_argument("--model", default="rule-of-thumb", help="language model; rule-of-thumb needs none")
    logs.add_argument("--text", type=Path, metavar="DIR", help="write the text of each log there")
    bugs = kinds.add_parser("bugs", help="RQ2: triggers of ten known bugs")
    bugs.add_argument("--model", default="relevance", help="see `saflite list scorers`")
    bugs.add_argument(
        "--words", choices=("paper", "policy", "none"), default="paper", help="what the model is told of the policy"
    )
    bugs.add_argument("--rng-seed", type=arguments.rng_seed, default=1, help="random seed of the values")
    for kind in (logs, bugs):
        kind.add_argument("--deadline", type=arguments.deadline_s, default=120.0, metavar="S", help="for one answer")
        kind.add_argument("--plot", type=Path, metavar="FILE.svg", help="draw the result")
        outputs.add_force(kind)
        kind.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Evaluate and print."""
    from saflite.console.evaluation import evaluating

    return evaluating.logs(args) if args.kind == "logs" else evaluating.bugs(args)
