"""Files of strangers: tables and models, each with one feature that public files have.

    python tests/benchmarks/strangers.py [--seed 0]

`strangers_tables.py` and `strangers_models.py` write the files with drawn numbers; each is read as
it is, or refused with the right word. What is not is listed.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import strangers_models
import strangers_tables


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    wrong = 0
    print(f"{'files':12}{'variants':>10}{'as they should be':>20}")
    for kind, part in (("tables", strangers_tables), ("models", strangers_models)):
        results = list(part.rows(seed))
        problems = [(name, message) for name, ok, message in results if not ok]
        print(f"{kind:12}{len(results):10}{1 - len(problems) / len(results):20.1%}")
        for name, message in problems:
            print(f"  {name}: {message:.300}")
        wrong += len(problems)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
