"""Write one campaign folder and say what is hidden in it."""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from truth.imperfect.families import FAMILIES, draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("family", choices=list(FAMILIES))
    parser.add_argument("seed", type=int)
    parser.add_argument("what", help="healthy, effect, pair, outside, or names of effects joined by +")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--size", type=float, default=1.0, help="over the size that must be found")
    given = parser.parse_args()
    print(json.dumps(asdict(draw(given.family, given.seed, given.what, given.folder, given.size)), indent=1))


if __name__ == "__main__":
    main()
