"""`masking` as the installed script calls it; what a report takes, its imports too, is written to the output folder."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from masking.app import cli
from masking.lab.runs import experiment  # noqa: F401  (what a run imports is no part of the report)

begin = time.perf_counter()
from masking.reports import run_report  # noqa: E402  (timed)

LOADING = time.perf_counter() - begin
write = run_report.report


def report(*arguments: Any, **settings: Any) -> run_report.Report:
    """Write a report, and how long that took to `seconds.json` in the last argument of the command line."""
    start = time.perf_counter()
    found = write(*arguments, **settings)
    Path(sys.argv[-1], "seconds.json").write_text(json.dumps(LOADING + time.perf_counter() - start), encoding="utf-8")
    return found


if __name__ == "__main__":
    run_report.report = report
    sys.exit(cli.main())
