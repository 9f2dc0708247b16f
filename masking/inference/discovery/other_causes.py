"""Other causes: laws in the place of those that were found first, which may only resemble the true ones."""

from __future__ import annotations

from collections.abc import Sequence

from masking.errors import IntegrationError
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.one_more_cause import ready


def other_causes(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with another effect in the place of each but the last, which has been chosen beside the others."""
    found: list[Explanation] = []
    for i in range(len(now.names) - 1):
        names, others = now.without(i)
        ground.tell(f"trying others than {now.names[i][0]}", 0.9)
        try:
            screen = ground.screen(ground.base.hypothesis, others)
        except IntegrationError:
            continue
        most = ground.worth(screen, now.cost / screen.every)
        scores = [one for one in screen.scores(ground.every) if one.candidate.key not in now.names]
        chosen = [one for one in scores if screen.total - one.gain < most][: ground.rules.few_fits]
        jobs = [ground.refit((one.candidate.key, *names), (ready(ground.problem, one), *others), now) for one in chosen]
        found += ground.noted("another in the place of a cause", jobs, now.cost)
    return found
