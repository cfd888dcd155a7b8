"""How much an answer is worth: temperature, the chance of being elsewhere, the verdict."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgloc.model import VERDICTS
from imgloc.options import Trust
from imgloc.search.trust import judge

TRUST = Trust(
    readings=10, temperature=2.0, strain=3.0, elsewhere=(-4.0, -0.5, 0.25), most=12.0, mass=0.9
)
misfits = st.floats(-5, 50)
gains = st.floats(-100, 100)
shares = st.floats(0, 1)
volumes = st.floats(-30, 0)


@pytest.mark.parametrize(("misfit", "expected"), [(0.0, 2.0), (0.5, 3.5), (4.0, 14.0), (-1.0, 2.0)])
def test_temperature_grows_with_the_misfit(misfit, expected):
    assert TRUST.temperature_at(misfit).value == pytest.approx(expected)


@given(st.integers(1, 10_000))
def test_half_of_many_readings_are_worth_more_than_half(n):
    some, many = (TRUST.temperature_at(0.5, k).value for k in (n, 4 * n))
    assert many == pytest.approx(2 * some)
    assert TRUST.temperature_at(0.5, 100).value == TRUST.temperature_at(0.5).value


def test_a_coarse_map_is_less_evidence():
    fine = TRUST.temperature_at(0.5).value
    assert TRUST.temperature_at(0.5, cell=TRUST.fine).value == fine
    assert TRUST.temperature_at(0.5, cell=3 * TRUST.fine).value == pytest.approx(3 * fine)


@pytest.mark.parametrize("trust", [TRUST, Trust()])
@given(a=misfits, b=misfits)
def test_a_worse_fit_never_sharpens_an_answer(trust, a, b):
    low, high = sorted((a, b))
    assert 0 < trust.temperature_at(low).value <= trust.temperature_at(high).value


@given(gains, volumes)
def test_the_chance_of_being_elsewhere_is_a_logistic_regression(gained, volume):
    nats = max(-12, min(gained, 12))
    # A hypothesis of 2 cm and 0.7 degrees in a place that is known to 2 m and 0.8 radians.
    near = math.log(2 * math.pi * 0.02**2 * math.radians(0.7) / (math.pi * 2.0**2 * 1.6))
    odds = -4.0 - 0.5 * nats + 0.25 * min(0, near - volume) * max(0, nats)
    expected = math.exp(odds) / (1 + math.exp(odds))
    assert TRUST.mass_elsewhere(gained, volume) == pytest.approx(expected)


@pytest.mark.parametrize("trust", [TRUST, Trust()])
@given(gained=gains, volume=volumes, worse=st.floats(0, 10), more=st.floats(0, 10))
def test_a_room_and_more_poses_make_elsewhere_likelier(trust, gained, volume, worse, more):
    here = trust.mass_elsewhere(gained, volume)
    assert 0 < here <= 1
    assert trust.mass_elsewhere(gained - worse, volume) >= here
    assert trust.mass_elsewhere(gained, volume - more) >= here


@pytest.mark.parametrize(
    ("valid", "mass", "elsewhere", "verdict"),
    [
        (9, [1.0], 0.0, "invalid"),
        (0, [], 1.0, "invalid"),
        (9, [0.1], 0.9, "invalid"),  # too few readings say nothing, not even that
        (10, [], 0.0, "no-match"),
        (10, [], 1.0, "no-match"),
        (10, [0.49], 0.51, "no-match"),
        (10, [0.95], 0.51, "no-match"),
        (10, [0.5], 0.5, "ambiguous"),
        (10, [1.0], 0.0, "unique"),
        (10, [0.9, 0.1], 0.0, "unique"),
        (10, [0.89, 0.11], 0.0, "ambiguous"),
        (181, [0.3, 0.1], 0.6, "no-match"),
    ],
)
def test_the_verdict(valid, mass, elsewhere, verdict):
    assert judge(valid, np.array(mass), elsewhere, TRUST)[0] == verdict
    assert verdict in VERDICTS


@given(st.integers(0, 500), shares, shares)
def test_better_evidence_never_makes_a_verdict_worse(valid, mass, elsewhere):
    rank = ["invalid", "no-match", "ambiguous", "unique"].index
    here = rank(judge(valid, np.array([mass]), elsewhere, TRUST)[0])
    assert rank(judge(valid + 1, np.array([mass]), elsewhere, TRUST)[0]) >= here
    assert rank(judge(valid, np.array([min(1, mass + 0.1)]), elsewhere, TRUST)[0]) >= here
    assert rank(judge(valid, np.array([mass]), max(0, elsewhere - 0.1), TRUST)[0]) >= here
