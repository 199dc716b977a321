"""``python -m ctc COMMAND``, as ``onepulse COMMAND``; without a command, the demo."""

import sys

from ctc.commandline import main

if __name__ == "__main__":
    arguments = sys.argv[1:]
    # Options alone are the demo's, but for those of which every command line has its answer.
    demo = not arguments or (
        arguments[0].startswith("-") and not {"-h", "--help", "--version"} & {*arguments}
    )
    raise SystemExit(main(["demo", *arguments] if demo else arguments))
