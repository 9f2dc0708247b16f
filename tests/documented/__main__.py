"""`python -m tests.documented`: check the numbers of the README and the documentation, or write them."""

from __future__ import annotations

import argparse
import sys
import time

from tests.documented import marks


def main() -> int:
    """Check or write the chosen numbers, and return how many differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="of the values, or all words of a mark; all by default"
    )
    parser.add_argument("--write", action="store_true", help="write what the code gives into the pages")
    chosen = parser.parse_args()
    differ = 0
    for mark in [m for m in marks.marks() if not chosen.names or {m.call, m.call.split()[0]} & {*chosen.names}]:
        clock = time.perf_counter()
        computed = mark.computed()
        same = marks.is_same(mark.text, computed)
        state = (
            "as written"
            if same
            else "written anew"
            if chosen.write
            else f"differs:\n{mark.text}\n-- now --\n{computed}"
        )
        print(f"{mark.page.name}: {mark.call}: {state} ({time.perf_counter() - clock:.0f} s)", flush=True)
        if not same and chosen.write:
            marks.write(mark, computed)
        differ += not same and not chosen.write
    return differ


if __name__ == "__main__":
    sys.exit(main())
