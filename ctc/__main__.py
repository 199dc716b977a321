"""The paper from end to end, ``python -m ctc``: what ``onepulse demo`` runs."""

import sys

from ctc.commandline.main import main

if __name__ == "__main__":
    raise SystemExit(main(["demo", *sys.argv[1:]]))
