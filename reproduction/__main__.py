"""`python -m reproduction`: compute the figures and tables of the source document again, beside its numbers."""

import argparse
import json
import sys
from collections.abc import Sequence

from masking.app.cli.terminal import Bar, raise_interrupts
from masking.errors import MaskingError
from reproduction.document import compare


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is chosen, print it, and write the page; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m reproduction", description=__doc__)
    parser.add_argument(
        "--only", metavar="NUMBER", help="a figure, table or erratum, such as 7.2 or 'Table 4.2'; printed only"
    )
    parser.add_argument("--out", metavar="DIR", help="folder of thesis.md and its pictures (default: docs)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    chosen = parser.parse_args(arguments)
    raise_interrupts()
    out = chosen.out if chosen.only is not None else chosen.out or "docs"
    try:
        with Bar("computing") as bar:
            result = compare(only=chosen.only, out=out, progress=bar.tell)
    except MaskingError as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(result.as_dict(), indent=2, ensure_ascii=False) if chosen.json else result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
