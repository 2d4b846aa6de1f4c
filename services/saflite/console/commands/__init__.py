"""One file per command, found by its place: `configure(parser)` names the arguments, `run(args)` does it."""
