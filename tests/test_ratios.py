"""Run times compared fairly: turns, medians, and who is compared with whom."""

from imgloc.experiments.claims import time_claims
from imgloc.experiments.ratios import PAIRS, measure_ratios, take_turns


class Clock:
    """A clock that runs put forward: each takes the next of its times."""

    def __init__(self):
        self.now, self.order = 0.0, []

    def run(self, name, times):
        left = iter(times)

        def work():
            self.order.append(name)
            self.now += next(left)

        return work


def test_turns_change_who_comes_first_and_medians_are_taken():
    clock = Clock()
    runs = [clock.run("a", (1.0, 100.0, 3.0)), clock.run("b", (5.0, 5.0, 6.0))]
    assert take_turns(runs, 3, clock=lambda: clock.now) == (3.0, 5.0)
    assert "".join(clock.order) == "abbaab"


def test_each_pair_is_measured_in_each_world():
    taken = []
    found = measure_ratios(2, 1, trials=3, worlds=("curved",), advance=lambda: taken.append(1))
    assert [(r.world, r.method, r.rival, r.most) for r in found] == [("curved", *p) for p in PAIRS]
    assert all(r.value > 0 and r.ms > 0 and r.rival_ms > 0 for r in found)
    assert len(taken) == 2 * len(PAIRS)
    claims = time_claims(found)
    assert [c.holds for c in claims] == [r.value <= r.most for r in found]
