"""`python -m tests.benchmarks.certificates [PART OF A NAME ...]`: a table of models, truths, verdicts and times."""

from __future__ import annotations

import sys
import time
from collections import Counter

from masking.analysis.stability.energy_certificate import Certificate, certificate
from masking.model.declaration.schema import ModelDeclaration
from masking.model.modelling.model import Model
from tests.benchmarks.certificates.comparison import proved, wrong
from tests.benchmarks.certificates.entry import Entry
from tests.benchmarks.certificates.models import GROUPS
from tests.benchmarks.certificates.truth import Truth


def certified(entry: Entry) -> Certificate:
    """Return the certificate of a model of the corpus."""
    return certificate(Model(ModelDeclaration.model_validate({"name": "test", **entry.declaration})))


def main() -> None:
    """Print the table; exit with 1 where a certificate is wrong."""
    parts, counts, total = sys.argv[1:], Counter[str](), 0.0
    print("| group | model | truth | proved of it | s | conclusion |\n|---|---|---|---|---|---|")
    for group, entries in GROUPS.items():
        for name, entry in entries.items():
            if parts and not any(part in name or part == group for part in parts):
                continue
            start = time.perf_counter()
            found = certified(entry)
            spent = time.perf_counter() - start
            truth = Truth(entry)
            slip, against = truth.mismatch(), wrong(found, truth)
            verdict = "WRONG" if against else proved(found, truth)
            counts[verdict] += 1
            counts["slip"] += bool(slip)
            total += spent
            print(
                f"{name}: {spent:.2f} s, truth {time.perf_counter() - start - spent:.2f} s", file=sys.stderr, flush=True
            )
            text = (
                f"{found.status}: {found.conclusion}"
                + f" WRONG: {against}" * bool(against)
                + f" TRUTH: {slip}" * bool(slip)
            )
            known = entry.truth.replace("|", "or")
            print(f"| {group} | {name} | {known} | {verdict} | {spent:.2f} | {text.replace('|', '/')} |", flush=True)
    print(f"\n{sum(counts.values()) - counts['slip']} models: {dict(counts)}; {total:.1f} s for the certificates")
    sys.exit(1 if counts["WRONG"] or counts["slip"] else 0)


if __name__ == "__main__":
    main()
