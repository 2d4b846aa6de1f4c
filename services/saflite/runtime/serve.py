"""One role of the farm as a process: `python -m saflite.runtime.serve ROLE --campaign NAME --connect ENDPOINT ...`.

Roles: books (with the router), router (alone), and the stages mutate, score, fly, judge, record. A role ends with
code 0 when it was told to stop or the campaign is over, or has done all it held after SIGUSR1 (`Launcher.drain`), 2 on
refused input, 3 where something it needs is missing, 4 where nobody has answered for its patience, 5 where it wants to
be started anew, 70 when our own code broke (the launcher starts it again, its leases are freed at once).
"""

from __future__ import annotations

import argparse
import faulthandler
import gc
import logging
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import NoReturn, get_args

from saflite.bus.crowds import LINKS_MAX
from saflite.bus.keyring import CERTIFICATE, FARM, REGISTER, Register, farm_credentials, peer_credentials, read_register
from saflite.bus.zenoh import Gate, ZenohBus, leave_process, open_client, open_router
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.join import check_worker_name
from saflite.contract.modules import use
from saflite.contract.work import Stage
from saflite.runtime import log_lines
from saflite.runtime.blob_client import BusBlobs, WorkerBlobs
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.local import DRAIN_SIGNAL
from saflite.runtime.software import card_of
from saflite.runtime.spool import Spool
from saflite.runtime.stages import ServiceContext, open_stage, worker_config
from saflite.runtime.supervisor import CENTRE
from saflite.runtime.turns import in_turn_to
from saflite.runtime.worker_shell import WorkerShell
from saflite.simulator_worker.processes import die_with_parent

log = logging.getLogger(__name__)

EXIT_FINE, EXIT_REFUSED, EXIT_UNAVAILABLE, EXIT_UNANSWERED, EXIT_AGAIN, EXIT_BROKEN = 0, 2, 3, 4, 5, 70
_EXITS = {"done": EXIT_FINE, "refused": EXIT_REFUSED, "unanswered": EXIT_UNANSWERED, "stuck": EXIT_AGAIN}
KEYS_CHANGED = "the farm's keys have changed"
KEYS_LOOK_S = LINKS_LOOK_S = 1.0
HANGS_S = 60.0  # without a turn of the worker's own loop; its leases were given to others long before
GARBAGE_AFTER = 20_000  # objects made and not freed: little in the books holds itself, and looking for it costs time


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    text = argparse.ArgumentParser(
        prog="python -m saflite.runtime.serve", description="One role of the farm as a process."
    )
    text.add_argument("role", choices=["books", "router", *get_args(Stage)])
    text.add_argument("--campaign", required=True, help="name of the campaign")
    text.add_argument("--connect", default="", help="router to connect to, e.g. unixsock-stream/PATH")
    text.add_argument("--listen", default="", help="where the router listens (books, router)")
    text.add_argument("--gate", default="", help="second endpoint of the router, tls/HOST:PORT, for those with keys")
    text.add_argument("--keys", type=Path, help="keys of the farm (with --gate), or of this worker")
    text.add_argument("--insecure", action="store_true", help="allow endpoints that others can reach")
    text.add_argument("--worker", default="", help="name of this worker, its own in the farm")
    text.add_argument("--run-dir", type=Path, help="run folder (books; others, if they can see it)")
    text.add_argument("--spool", type=Path, help="folder for results not yet acknowledged")
    text.add_argument("--module", type=Path, action="append", default=[], help="target, strategy, ... from outside")
    text.add_argument("--label", action="append", default=[], metavar="NAME=VALUE", help="said of it when it joins")
    text.add_argument("--patience", type=float, default=0.0, help="seconds without an answer after which it ends")
    text.add_argument("--json-logs", action="store_true", help="one JSON object a line (`runtime/log_lines.py`)")
    text.add_argument("--parent", type=int, default=0, help="end when this process ends")
    return text


def main(argv: list[str]) -> NoReturn:
    """Run one role until it ends, then end the process."""
    options = parser().parse_args(argv)
    log_lines.begin(options.campaign, options.role, options.worker or options.role, as_json=options.json_logs)
    if options.parent:
        die_with_parent(options.parent)
    code = EXIT_BROKEN
    try:
        code = _run(options)
    except Refused as fault:
        log.error("%s", fault)
        code = EXIT_REFUSED
    except FarmError as fault:
        log.error("%s", fault)
        code = EXIT_UNAVAILABLE
    finally:
        if code == EXIT_BROKEN:
            traceback.print_exc()
        leave_process(code)


def _run(options: argparse.Namespace) -> int:
    if options.role not in CENTRE:
        return _worker(options)
    why = _books(options) if options.role == "books" else _router(options)
    log.info("%s ends: %s", options.role, why)
    return EXIT_AGAIN if why == KEYS_CHANGED else EXIT_FINE


def _books(options: argparse.Namespace) -> str:
    from saflite.campaign.storage.store import Store
    from saflite.runtime import run_modules
    from saflite.runtime.books_service import BooksService
    from saflite.runtime.evidence import EvidenceService

    if options.run_dir is None:
        raise Refused("--run-dir", expected="the run folder", got="nothing")
    clock = WallClock()
    started_s = clock.monotonic_s()
    store = Store.open(options.run_dir)
    books = store.rebuild()
    books.begin(clock.monotonic_s(), clock.unix_s())
    gc.freeze()
    gc.set_threshold(GARBAGE_AFTER)
    log.info("books of %s rebuilt in %.2f s", options.campaign, clock.monotonic_s() - started_s)
    insecure = options.insecure
    keys = _keys_now(options.keys) if options.gate and options.keys is not None else {}
    gate = _gate(options, clock)
    if options.listen:
        bus = open_router("books", options.listen, insecure=insecure, gate=gate)
    else:
        bus = open_client("books", options.connect, insecure=insecure)
    evidence = EvidenceService(bus, options.campaign, store.blobs)
    modules = run_modules.needed(options.run_dir, books.campaign)
    register = gate.register if gate is not None else Register(hosts=())
    key_of = register.key_of()
    store.blobs.forget_all_of(lambda worker: register.is_revoked(key_of(worker)))
    service = BooksService(bus, options.campaign, books, store, clock, evidence, modules=modules, key_of=key_of)
    evidence.tell_excess(service.complain)
    evidence.heed(books.owner_of, key_of)
    _on_signals(service.stop)
    if gate is not None:
        _bound_crowds(bus, clock, service.complain, service.crowded)
    if keys:
        _on_change(keys, clock, service.stop)
    why = service.run()
    bus.close()
    evidence.close()
    if books.ended:
        store.blobs.forget_all()
    store.close()
    return why


def _router(options: argparse.Namespace) -> str:
    waiting = signal.sigwait  # nothing to do but wait for a signal
    signals = {signal.SIGTERM, signal.SIGINT}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    clock = WallClock()
    gate = _gate(options, clock)
    bus = open_router("router", options.listen, insecure=options.insecure, gate=gate)
    if gate is not None:
        _bound_crowds(bus, clock, lambda where, words: log.warning("from %s: %s", where, words), set())
    number = waiting(signals)
    bus.close()
    return f"signal {signal.Signals(number).name}"


def _worker(options: argparse.Namespace) -> int:
    use(options.module)
    clock = WallClock()
    name = check_worker_name(options.worker or options.role)
    try:
        bus = _client(name, options, clock)
    except Unavailable as fault:
        log.error("%s", fault)
        return EXIT_UNANSWERED
    spool = Spool(options.spool, options.run_dir)
    over_bus = BusBlobs(bus, options.campaign, name, clock)
    blobs = WorkerBlobs(over_bus, name, options.run_dir, spool.waiting())
    context = ServiceContext(name, clock, options.run_dir, blobs)
    service = open_stage(options.role, context)
    config = worker_config(options.role, name, service)._replace(patience_s=options.patience)
    labels = dict(text.partition("=")[::2] for text in options.label)
    card = card_of(options.role, name, clock, targets=config.targets, labels=labels)
    shell = WorkerShell(bus, options.campaign, service, config, card, spool, clock)
    shell.on_turn, shell.denied = end_unless_said_again, bus.denied
    _on_signals(shell.stop)
    signal.signal(DRAIN_SIGNAL, lambda _got, _frame: shell.drain())
    left = shell.run()
    bus.close()
    service.close()
    log.log(logging.INFO if left.left_for == "done" else logging.ERROR, "%s", left.why)
    return _EXITS[left.left_for]


def end_unless_said_again() -> None:
    """End this process, with code 1 and where it hangs on stderr, unless this is called again within `HANGS_S`.

    Compiled code that keeps the interpreter to itself and never returns stops heartbeats, signals and deadlines alike;
    what tells the time here is a thread that needs no interpreter.
    """
    faulthandler.dump_traceback_later(HANGS_S, exit=True)


def _client(name: str, options: argparse.Namespace, clock: WallClock) -> ZenohBus:
    """Connect; with keys, one process of this user after the other: see `bus/reach.py` for what many at once do."""
    keys = peer_credentials(options.keys, clock.unix_s()) if options.keys is not None else None
    with in_turn_to(options.connect) if keys is not None else nullcontext():
        return open_client(
            name, options.connect, patience_s=options.patience or None, insecure=options.insecure, keys=keys
        )


def _gate(options: argparse.Namespace, clock: WallClock) -> Gate | None:
    if not options.gate:
        return None
    if options.keys is None:
        raise Refused("--keys", expected="the farm's keys, with --gate", got="nothing")
    return Gate(options.gate, farm_credentials(options.keys, clock.unix_s()), read_register(options.keys))


def _keys_now(folder: Path) -> dict[Path, bytes]:
    """Return what a router goes by that may change while it works: the register, and its own certificate."""
    return {path: path.read_bytes() for path in (folder / REGISTER, folder / FARM / CERTIFICATE) if path.is_file()}


def _on_change(began: Mapping[Path, bytes], clock: WallClock, stop: Callable[[str], None]) -> None:
    """Stop when keys are no more as they were before the router began: it takes them as it starts."""

    def look() -> None:
        while True:
            clock.sleep_s(KEYS_LOOK_S)
            try:
                changed = any(path.read_bytes() != before for path, before in began.items())
            except OSError:
                continue
            if changed:
                stop(KEYS_CHANGED)
                return

    threading.Thread(target=look, name="keys", daemon=True).start()


def _bound_crowds(bus: ZenohBus, clock: WallClock, tell: Callable[[str, str], None], crowded: set[str]) -> None:
    """End what connections a key has beyond its share, as long as this process lives, and have it told.

    All are ended of keys that somebody puts into `crowded`: what else they hold at the router goes with them.
    """

    def look() -> None:
        while True:
            clock.sleep_s(LINKS_LOOK_S)
            keys = {crowded.pop() for _ in range(len(crowded))}
            for key, count in bus.end_surplus(LINKS_MAX, keys).items():
                why = "its tokens are too many" if key in keys else f"a key may have {LINKS_MAX}"
                tell(f"{key} on connections", f"{count} ended: {why}")

    threading.Thread(target=look, name="crowds", daemon=True).start()


def _on_signals(stop: Callable[[str], None]) -> None:
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda got, _frame: stop(f"signal {signal.Signals(got).name}"))


if __name__ == "__main__":
    main(sys.argv[1:])
