"""Runs from the best to the worst, each tested against the best: what the tables and the page say comes from here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from depthcli.evaluation.statistics import PairedTest, compare, holm, smallest_p

SIGNIFICANT = 0.05
"""Level that a corrected p value has to be below."""

_MAX_NAMES = 3  # of runs in a sentence


@dataclass(frozen=True)
class Ranking:
    """Runs in the order of their single figure, and the test of every further one against the best.

    Attributes
    ----------
    runs : names, the best first
    tests : run -> its comparison with the best run, scene by scene; all runs but the best
    p_values : run -> p value of that test, corrected after Holm for the number of tests; NaN without a common scene
    """

    runs: tuple[str, ...]
    tests: Mapping[str, PairedTest]
    p_values: Mapping[str, float]

    @classmethod
    def of(cls, runs: Sequence[str], by_scene: Mapping[str, Sequence[float]]) -> Ranking:
        """Test every run but the first, which is the best, against the first.

        Parameters
        ----------
        runs : names, the best first
        by_scene : run -> figure of every scene, lower is better, NaN where there is none
        """
        best, *others = runs
        tests = {run: compare(by_scene[best], by_scene[run]) for run in others}
        corrected = holm([test.p_value for test in tests.values()])
        return cls(tuple(runs), tests, dict(zip(tests, corrected, strict=True)))

    @property
    def n_tests(self) -> int:
        """Number of tests that the p values are corrected for."""
        return sum(not math.isnan(p) for p in self.p_values.values())

    @cached_property
    def n_scenes(self) -> int:
        """Number of scenes of the test that has most."""
        return max((test.scenes for test in self.tests.values()), default=0)

    def is_significant(self, run: str) -> bool:
        """Return True where a run differs from the best more than chance would do."""
        return self.p_values[run] < SIGNIFICANT

    def word(self, run: str) -> str:
        """Return what the test says of a run, in a word or two."""
        if run not in self.tests:
            return "best"
        if not self.tests[run].scenes:
            return "no common scene"
        if smallest_p(self.tests[run].scenes, self.n_tests) >= SIGNIFICANT:
            return "too few scenes"
        if not self.is_significant(run):
            return "not significant"
        return "worse" if self.tests[run].rank_difference > 0 else "better in most"

    def verdict(self) -> str:
        """Return what the tests say, in a sentence or two; empty where there is one run."""
        if not self.tests:
            return ""
        if not self.n_tests:
            return "No scene has a map of two runs: nothing can be tested."
        lowest = smallest_p(self.n_scenes, self.n_tests)
        if lowest >= SIGNIFICANT:
            enough = next(n for n in range(2, 99) if smallest_p(n, self.n_tests) < SIGNIFICANT)
            count = f"{self.n_scenes} scene{'s' * (self.n_scenes != 1)}"
            return (
                f"With {count} no difference can be significant: p is {lowest:.2g} or more; it takes {enough} scenes."
            )
        worse = [run for run in self.tests if self.is_significant(run) and self.tests[run].rank_difference > 0]
        better = [run for run in self.tests if self.is_significant(run) and self.tests[run].rank_difference < 0]
        if not worse and not better:
            return f"No significant difference (the smallest p is {min(self.p_values.values()):.2g})."
        even = [run for run in self.tests if not self.is_significant(run)]
        said = []
        if worse:
            every = "every other run" if len(worse) == len(self.tests) > 1 else _names(worse)
            said.append(f"{self.runs[0]} is significantly better than {every}.")
        if better:
            said.append(f"In most scenes {_names(better)} is significantly better, though not in the mean.")
        if even:
            said.append(f"No significant difference to {_names(even)}.")
        return " ".join(said)


def _names(runs: Sequence[str]) -> str:
    if len(runs) > _MAX_NAMES:
        return f"{', '.join(runs[:_MAX_NAMES])} and {len(runs) - _MAX_NAMES} more"
    return " and ".join(filter(None, [", ".join(runs[:-1]), runs[-1]]))
