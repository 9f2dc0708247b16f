"""Search: what explains the gap best: nothing, a parameter that is wrong, or effects, one after the other.

Hypotheses are compared by their cost, -2 log likelihood with the belief in the rig's parameters, and what each added
parameter must pay: log of the number of readings (Schwarz). Where even the best leaves more than noise, or noise that
is not white, differences count for less, by how much more is left and how slowly it changes.
Source: Schwarz (1978), Annals of Statistics 6(2), 461-464; Kass and Raftery (1995), JASA 90(430), 773-795.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from masking.discovery import fitting
from masking.discovery.candidates import Candidate, Span, candidates
from masking.discovery.evidence import Belief, Evidence
from masking.discovery.fitting import Hypothesis
from masking.discovery.opened import Slot
from masking.discovery.screening import Promise, Screen
from masking.discovery.smoothing import Motion, smooth
from masking.errors import IntegrationError
from masking.kernels import Array

Tell = Callable[[str, float], None]

FEWEST, FITTED = 3, 8  # candidates that are fitted in full in each round
WORTH = 2.5  # a candidate is fitted where it leaves at most so many times what the best leaves, beyond noise
SIGN = 20.0  # of the cost, beyond what its parameters must pay, from which anything is said to be there
MOST_EFFECTS = 3
SAME = 0.03  # part of its effect that a candidate must have for itself, not to be a parameter under another name
TONES = 4
NEAR = 4.0  # cost per reading below which what is left of a fit is small enough to be looked at by itself


@dataclass(frozen=True)
class Explanation:
    """A hypothesis with what it is called and how it scores.

    Args:
        kind: `none`, `parameter` or `effects`.
        names: (parameter, '') or (effect, place) of each.
        hypothesis: fitted.
        score: its cost with what its parameters pay.
        own: least part of an effect that parameters could not have.
    """

    kind: str
    names: tuple[tuple[str, str], ...]
    hypothesis: Hypothesis
    score: float
    own: float = 1.0


@dataclass(frozen=True)
class Found:
    """What a search found: the steps that were taken, and the explanations of the last, best first.

    Args:
        base: the rig as believed, fitted within belief.
        steps: the best explanation after each step.
        rivals: explanations of the same number of causes as the last step, best first, the chosen one included.
        temperature: by which differences of scores are divided.
        motion: smoothed record.
        screen: of the base.
    """

    base: Explanation
    steps: tuple[Explanation, ...]
    rivals: tuple[Explanation, ...]
    temperature: float
    motion: Motion
    tried: tuple[Promise, ...] = field(default=())

    @property
    def best(self) -> Explanation:
        """Return the explanation that was chosen."""
        return self.steps[-1] if self.steps else self.base


@dataclass(frozen=True)
class Search:
    """A search in one record.

    Args:
        evidence: the record and the rig.
        tell: told what is done, and the part done.
    """

    evidence: Evidence
    tell: Tell = lambda text, part: None

    @property
    def price(self) -> float:
        """Return what each added parameter must pay."""
        return float(np.log(self.evidence.record.readings.size))

    def run(self) -> Found:
        """Search for causes, one after the other, until nothing pays."""
        self.tell("fitting the model as it is", 0.0)
        base = Explanation("none", (), self._fit((), None, None), 0.0)
        base = Explanation("none", (), base.hypothesis, base.hypothesis.cost)
        self.tell("smoothing the motion", 0.1)
        motion = smooth(self.evidence, base.hypothesis.theta, base.hypothesis.start)
        every = list(candidates(self.evidence.rig, self._spans(motion, base.hypothesis), self.evidence.dt))
        steps: list[Explanation] = []
        rivals: tuple[Explanation, ...] = (base,)
        tried: tuple[Promise, ...] = ()
        now = base
        for number in range(MOST_EFFECTS):
            self.tell(f"screening {len(every)} candidates", 0.2 + 0.25 * number)
            near = now.hypothesis.cost < NEAR * self.evidence.record.readings.size
            looked_at = now.hypothesis if near else base.hypothesis
            screen = Screen(self.evidence, looked_at, motion, now.hypothesis.slots, taken=near)
            promises = screen.promises(every)
            tried = tried or tuple(promises)
            found = self._round(now, promises, screen, parameters=number == 0)
            temperature = self.temperature((found or [now])[0].hypothesis)
            if not found or (now.score - found[0].score) / temperature < SIGN:
                break
            now = found[0]
            steps.append(now)
            rivals = tuple(found)
            if now.kind == "parameter":
                break
        if len(steps) > 1:
            steps[-1], rivals = self._exchange(steps[-1], rivals, steps)
        best = (steps or [base])[-1]
        return Found(base, tuple(steps), rivals, self.temperature(best.hypothesis), motion, tried)

    def temperature(self, hypothesis: Hypothesis) -> float:
        """Return by how much more is left than white noise, and how much more slowly it changes; at least 1."""
        found = 1.0
        for column, sigma in zip(hypothesis.residuals.T, self.evidence.sigma, strict=True):
            ratio = float((column**2).mean() / sigma**2)
            blocks = column[: len(column) // 32 * 32].reshape(-1, 32).mean(axis=1)
            slow = float((blocks**2).mean() * 32.0 / sigma**2)
            found = max(found, ratio, min(slow, 400.0) if slow > 1.3 else 1.0)
        return found

    def _round(
        self, now: Explanation, promises: Sequence[Promise], screen: Screen, *, parameters: bool
    ) -> list[Explanation]:
        """Return explanations with one more cause, best first."""
        jobs: list[Callable[[], Explanation]] = []
        if parameters:
            gains = self._releases(now.hypothesis)
            for i in np.argsort(-gains)[:3]:
                if gains[i] > self.price:
                    jobs.append(lambda i=int(i): self._released(now, i))  # type: ignore[misc]
        noise = float(self.evidence.record.readings.size // screen.every)
        best = max([promise.gain for promise in promises] + [*self._releases(now.hypothesis)], default=0.0)
        least = max(screen.total - best - noise, 0.05 * noise)
        chosen: list[Promise] = []
        for promise in promises:
            left = screen.total - promise.gain - noise
            pays = promise.gain > self.price * len(promise.candidate.free) + 0.5 * SIGN
            if promise.candidate.key in now.names or not pays or len(chosen) == FITTED:
                continue
            if left < WORTH * least + 0.3 * noise or len(chosen) < FEWEST:
                chosen.append(promise)
        for promise in chosen:
            jobs.append(lambda p=promise: self._added(now, p))  # type: ignore[misc]
        self.tell(f"fitting {len(jobs)} of them", 0.3)
        with ThreadPoolExecutor(2) as pool:
            found = [e for e in pool.map(self._tried, jobs) if e is not None]
        merged: dict[tuple[tuple[str, str], ...], Explanation] = {}
        for explanation in found:
            key = tuple(sorted(explanation.names))
            if key not in merged or explanation.score < merged[key].score:
                merged[key] = explanation
        return sorted(merged.values(), key=lambda e: e.score)

    @staticmethod
    def _tried(job: Callable[[], Explanation]) -> Explanation | None:
        try:
            return job()
        except IntegrationError:
            return None

    def _exchange(
        self, best: Explanation, rivals: tuple[Explanation, ...], steps: list[Explanation]
    ) -> tuple[Explanation, tuple[Explanation, ...]]:
        """Leave out each cause in turn: where the rest is as good without it, it goes."""
        for i in range(len(best.names) - 1):
            slots = tuple(s for j, s in enumerate(best.hypothesis.slots) if j != i)
            names = tuple(n for j, n in enumerate(best.names) if j != i)
            try:
                less = self._fit(slots, best.hypothesis.theta, best.hypothesis.start)
            except IntegrationError:
                continue
            score = less.cost + self.price * sum(len(s.free) for s in slots)
            if score < best.score + SIGN * self.temperature(best.hypothesis):
                made = Explanation("effects", names, less, score, best.own)
                return made, (made, *rivals)
        return best, rivals

    def _fit(
        self, slots: tuple[Slot, ...], theta: Array | None, start: Array | None, belief: Belief | None = None
    ) -> Hypothesis:
        evidence = self.evidence if belief is None else replace(self.evidence, belief=belief)
        return fitting.fit(evidence, slots, theta=theta, start=start)

    def _added(self, now: Explanation, promise: Promise) -> Explanation:
        slots = (*now.hypothesis.slots, promise.slot)
        found = self._fit(slots, now.hypothesis.theta, now.hypothesis.start)
        score = found.cost + self.price * sum(len(s.free) for s in slots)
        return Explanation("effects", (*now.names, promise.candidate.key), found, score, promise.own)

    def _released(self, now: Explanation, index: int) -> Explanation:
        belief = self.evidence.belief.released(index)
        found = self._fit((), now.hypothesis.theta, now.hypothesis.start, belief)
        return Explanation("parameter", ((self.evidence.rig.names[index], ""),), found, found.cost + self.price)

    def _releases(self, hypothesis: Hypothesis) -> Array:
        """Return what setting each parameter free would take off the cost, to first order (k,)."""
        k = len(self.evidence.belief.mean)
        pull = (hypothesis.theta - self.evidence.belief.mean) / self.evidence.belief.deviation
        variance = np.diag(hypothesis.covariance)[:k] / self.evidence.belief.deviation**2
        # The parameter's own term of the belief, and what the others give once it is gone.
        found: Array = pull**2 / np.maximum(1.0 - variance, 1e-12)
        return np.where(variance < 1.0 - 1e-9, found, 0.0)

    def _spans(self, motion: Motion, base: Hypothesis) -> dict[str, Span]:
        found = {}
        for i, place in enumerate(self.evidence.rig.places):
            x = motion.displacement[:, i]
            tones = self._tones(motion.forces)
            found[place.name] = Span(
                float(x.min()), float(x.max()), float(np.abs(x).max()), float(motion.rate[:, i].std()), tones
            )
        for names, table in (
            (self.evidence.rig.twin.sensors, self.evidence.record.readings),
            (self.evidence.rig.twin.actuators, self.evidence.record.commands),
        ):
            for name, x in zip(names, table.T, strict=True):
                found[name] = Span(float(x.min()), float(x.max()), float(np.abs(x).max()), 0.0)
        return found

    def _tones(self, forces: Array) -> tuple[float, ...]:
        """Return the frequencies in Hz at which the lacking forces are strongest."""
        window = np.hanning(len(forces))
        many = 4 * len(forces)
        power = sum(
            np.abs(np.fft.rfft(column * window, many)) ** 2 / column.var() for column in forces.T if column.var() > 0
        )
        if isinstance(power, int):
            return ()
        frequencies = np.fft.rfftfreq(many, 1.0 / self.evidence.record.rate)
        power = np.where((frequencies > 0.05) & (frequencies < 0.4 * self.evidence.record.rate), power, 0.0)
        found = []
        for _ in range(TONES):
            i = int(np.argmax(power))
            found.append(float(frequencies[i]))
            power[max(0, i - 12) : i + 13] = 0.0
        return tuple(found)


def probabilities(explanations: Sequence[Explanation], temperature: float) -> Array:
    """Return the probability of each explanation among these (e,)."""
    scores = np.array([e.score for e in explanations]) / temperature
    weights = np.exp(-0.5 * (scores - scores.min()))
    found: Array = weights / weights.sum()
    return found


__all__ = ["Candidate", "Explanation", "Found", "Search", "probabilities"]
