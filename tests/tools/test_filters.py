"""Runs along logs, and what is made of them by the rules of others."""

import numpy as np
import pytest

from imgloc import ConfigError, LaserScan, ScanSet
from imgloc.filters.follow import with_odometry
from imgloc.filters.motion import increments
from tools.filters import Run, driven, for_good, piece, recovered, starts, summarise_runs


def line(n: int = 40, step: float = 0.5) -> ScanSet:
    scans = tuple(LaserScan([1.0 + k], [0.0], range_max=99.0) for k in range(n))
    poses = np.column_stack((np.arange(n) * step, np.zeros(n), np.zeros(n)))
    return ScanSet(scans, poses, 2.0 * np.arange(n), poses + (5.0, 0.0, 0.0))


def run(error, unique=None, jump=None, seconds=None, cost=1.0) -> Run:
    error = np.asarray(error, dtype=float)
    n = len(error)
    seconds = np.arange(n) * 2.0 if seconds is None else np.asarray(seconds, dtype=float)
    unique = np.ones(n) if unique is None else np.asarray(unique, dtype=float)
    both = np.column_stack((error, np.zeros(n)))
    square = np.square(error / 0.1)
    none, way = np.zeros(n), np.arange(n) * 1.0
    return Run(seconds, way, both, unique, none, cost, 0.1 * both, square, unique, jump)


def test_a_kidnapping_joins_two_pieces_and_odometry_notices_nothing() -> None:
    both = piece(line(), range(2, 5), range(30, 33))
    assert [scan.ranges[0] for scan in both.scans] == [3, 4, 5, 31, 32, 33]
    assert both.odom is not None
    np.testing.assert_allclose(both.poses[:, 0], [1, 1.5, 2, 15, 15.5, 16])
    steps = increments(both.odom)
    np.testing.assert_allclose(steps[:, 0], [0.5, 0.5, 0, 0.5, 0.5])
    np.testing.assert_allclose(np.diff(both.stamps), 2.0)


def test_no_scan_of_a_robot_that_is_carried_back_is_the_same_to_the_bit() -> None:
    first, _, again, _ = piece(line(), range(2, 4), range(2, 4)).scans
    assert (first.ranges != again.ranges).all()
    np.testing.assert_allclose(first.ranges, again.ranges, atol=0.01)


def test_odometry_that_was_recorded_is_taken() -> None:
    recorded = line()
    assert with_odometry(recorded) == (recorded, "recorded")
    bare = ScanSet(recorded.scans, recorded.poses, recorded.stamps)
    made, kind = with_odometry(bare, seed=1)
    assert "noise" in kind
    assert made.odom is not None
    assert recorded.poses is not None
    ratio = np.hypot(*increments(made.odom)[:, :2].T).sum() / driven(recorded)[-1]
    assert ratio == pytest.approx(1.02, abs=0.03)
    with pytest.raises(ConfigError, match="poses"):
        with_odometry(ScanSet(recorded.scans))


def test_starts_have_way_ahead() -> None:
    log = line()
    at = starts(log, 30, np.random.default_rng(0), ahead=10.0)
    assert len(at) == 30 + 2  # one each 30 s
    assert at[30:] == [0, 15]
    assert max(driven(log)[at]) <= driven(log)[-1] - 10 + 0.5
    short = starts(log, 3, np.random.default_rng(0), ahead=1000.0)
    assert set(short) == {0}
    some = starts(log, 12, np.random.default_rng(0), ahead=10.0, seconds=np.inf)
    assert len(set(some)) == len(some) == 12


def test_right_for_good() -> None:
    assert for_good(np.array([1, 1])).tolist() == [1, 1]
    assert for_good(np.array([0, 0])).tolist() == [0, 0]
    assert for_good(np.array([0, 1, 0, 1, 1])).tolist() == [0, 0, 0, 1, 1]


def test_shares_are_of_the_moments_and_of_all_later_ones() -> None:
    flips = run([0.1, 0.1, 0.1, 5.0] + [0.1] * 10)
    good = run([9.0] + [0.1] * 13)
    got = summarise_runs([flips, good])
    assert got["right"]["0"]["value"] == 0.5
    assert got["right"]["2"]["value"] == 1.0
    assert got["stays"]["2"]["value"] == 0.5
    assert got["stays"]["5"]["value"] == 1.0
    assert got["right"]["10"]["trials"] == 2
    assert summarise_runs([run([0.1] * 4)])["right"]["10"]["trials"] == 0  # too short to say


def test_seconds_confidently_wrong_are_counted() -> None:
    bad = run([0.1, 3.0, 3.0, 0.1], unique=[1, 1, 0, 1])
    got = summarise_runs([bad])
    assert (got["wrong"], got["wrong_moments"], got["total"]) == (2.0, 1, 6.0)
    assert got["speed"] == pytest.approx(6.0)


def test_rmse_is_after_convergence_and_of_what_is_published() -> None:
    got = summarise_runs([run([4.0, 0.3, 0.4, 0.45], unique=[1, 1, 0, 1])])
    assert got["rmse"][0] == pytest.approx(np.sqrt((0.3**2 + 0.45**2) / 2))
    assert (got["seconds"], got["metres"]) == (2.0, 1.0)


def test_recovery_by_the_rule_of_jair() -> None:
    away = [0.1] * 3 + [8.0] * 4
    assert recovered(run(away + [0.2] * 8, jump=3)) == 4.0
    brief = away + [0.2] * 3 + [8.0] * 3  # 4 s within 0.45 m: no recovery
    assert recovered(run(brief, jump=3)) is None
    assert recovered(run([0.1] * 3)) is None
    got = summarise_runs([run([0.1] * 4)], [run(away + [0.2] * 8, jump=3), run(brief, jump=3)])
    assert (got["kidnapped"]["hits"], got["kidnapped"]["trials"]) == (1, 2)
    assert got["kidnap_metres"] == 4.0


def test_rules_of_others() -> None:
    good, late = run([2.0] * 10 + [0.1] * 15), run([0.1] * 24 + [0.6])
    got = summarise_runs([good, late])
    assert got["enm"]["value"] == 1.0  # RMSE from 20 s on
    assert got["f3loc"]["1"]["value"] == 1.0
    assert got["f3loc"]["0.5"]["value"] == 0.5
    assert got["f3loc"]["0.2"]["value"] == 0.5
