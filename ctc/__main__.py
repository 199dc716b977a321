"""``python -m ctc COMMAND``, as ``onepulse COMMAND``; without a command, the demo."""

import sys

from ctc.commandline.main import main

if __name__ == "__main__":
    arguments = sys.argv[1:]
    # Options alone are the demo's.
    demo = not arguments or arguments[0].startswith("-")
    raise SystemExit(main(["demo", *arguments] if demo else arguments))
