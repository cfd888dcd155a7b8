"""Priors: which poses are in them, and what a search makes of them."""

import os
from collections import Counter

import numpy as np
import pytest

import imgloc
from imgloc import ALL_METHODS, ConfigError, FusedOptions, Known, Options, Prior, Sensor, simulate
from imgloc.features.pyramid import Level
from imgloc.geometry import pose_errors, poses_of
from imgloc.model import GridInfo, LaserScan, OccupancyGrid, Pose2D
from imgloc.options import RADIUS, TOLERANCE
from imgloc.pipeline import localize, prepare
from imgloc.search.priors import (
    ASTRAY,
    clearance,
    near,
    nearest,
    on_lattice,
    prior_of,
    pyramid_levels,
    ranked,
)
from imgloc.simulation.worlds import WORLDS, render

# One row, 1 m cells: the sensor may be in the second and third.
CELLS = np.array([[False, True, True, False]])


def test_a_cell_holds_its_lower_edges():
    poses = np.array([[0.999, 0.5, 0], [1.0, 0.0, 0], [2.999, 0.999, 0], [3.0, 0.5, 0]])
    assert Prior(CELLS).admits(poses, 1.0).tolist() == [False, True, True, False]


def test_poses_off_the_map_are_not_in_it():
    poses = np.array([[1.5, -0.1, 0], [1.5, 1.1, 0], [-0.5, 0.5, 0], [9.0, 0.5, 0]])
    assert not Prior(CELLS).admits(poses, 1.0).any()
    assert Prior().admits(poses, 1.0).all()  # nothing is known


def test_headings_wrap_around():
    prior = Prior(heading=(np.pi, 0.2))
    thetas = np.array([np.pi - 0.1, -np.pi + 0.1, np.pi - 0.3, 0.0, 3 * np.pi])
    assert prior.headings(thetas).tolist() == [True, True, False, False, True]
    assert prior.headings(thetas, 0.15).tolist() == [True, True, True, False, True]


def test_both_must_allow_a_pose():
    both = Prior(CELLS, None, {"a": 1}) & Prior(~CELLS | [[0, 1, 0, 0]], (0.0, 1.0), {"b": 2})
    assert both.cells.tolist() == [[False, True, False, False]]
    assert both.heading == (0.0, 1.0)
    assert both.about == {"a": 1, "b": 2}
    with pytest.raises(ConfigError, match="twice"):
        both & both


def test_a_lattice_cell_stays_if_any_of_its_cells_does():
    free = np.array([[True, True]])
    assert on_lattice(Prior(CELLS), free, 2).tolist() == [[True, True]]
    assert on_lattice(Prior(np.array([[0, 0, 1, 0]], bool)), free, 2).tolist() == [[False, True]]
    levels = (Level(np.zeros((1, 2), np.uint8), free, 2.0),)
    assert pyramid_levels(Prior(np.array([[0, 0, 1, 0]], bool)), levels, 1.0)[0].free.tolist() == [
        [False, True]
    ]


def test_what_is_just_outside_is_moved_to_the_nearest_cell_and_heading():
    prior = Prior(CELLS, (np.pi, 0.2))
    poses = [[0.9, 0.5, 3.0], [3.3, 0.9, np.pi - 0.3], [1.5, 0.5, -np.pi + 0.4], [1.2, 0.3, 3.1]]
    moved = nearest(prior, np.array(poses), 1.0)
    assert prior.admits(moved, 1.0).all()
    expected = [[1, 0.5, 3.0], [3, 0.9, np.pi - 0.2], [1.5, 0.5, -np.pi + 0.2], [1.2, 0.3, 3.1]]
    np.testing.assert_allclose(moved, expected, atol=1e-5)
    assert moved[3].tolist() == poses[3]  # to the last bit
    assert nearest(Prior(), np.array(poses), 1.0).tolist() == poses


def test_what_is_far_outside_is_left_out():
    prior = Prior(np.eye(1, 20, dtype=bool), (0.0, 0.2))
    poses = np.array([[0.55, 0.05, 0.0], [0.75, 0.05, 0.0], [0.05, 0.05, 0.5], [0.05, 0.05, 0.4]])
    np.testing.assert_allclose(
        nearest(prior, poses, 0.1), [[0.1, 0.05, 0], [0.05, 0.05, 0.2]], atol=1e-5
    )


def test_the_nearest_cell_is_the_nearest():
    rng = np.random.default_rng(0)
    cells = rng.random((40, 30)) < 0.01
    poses = np.column_stack((rng.uniform((-0.2, -0.2), (3.2, 4.2), (200, 2)), np.zeros(200)))
    moved = nearest(Prior(cells), poses, 0.1)
    at = np.argwhere(cells)
    away = np.sqrt(np.square(np.floor(poses[:, None, 1::-1] / 0.1) - at).sum(axis=2)).min(axis=1)
    assert len(moved) == np.count_nonzero(away <= 5)  # 0.5 m
    kept = poses[away <= 5]
    np.testing.assert_allclose(
        np.hypot(*(np.floor(moved[:, :2] / 0.1) - np.floor(kept[:, :2] / 0.1)).T), away[away <= 5]
    )


def test_near_is_a_disc_of_centres():
    disc = near(GridInfo(3, 3, 1.0), 1.5, 1.5, 1.0)
    assert disc.astype(int).tolist() == [[0, 1, 0], [1, 1, 1], [0, 1, 0]]


def test_near_holds_the_cell_of_the_point_however_small_the_radius():
    assert np.argwhere(near(GridInfo(3, 3, 1.0), 1.05, 2.95, 0.01)).tolist() == [[2, 1]]
    assert not near(GridInfo(3, 3, 1.0), 3.05, 2.95, 0.01).any()  # off the map


def test_clearance_is_from_walls_unknown_cells_and_the_edge():
    free = np.ones((7, 9), bool)
    free[:, 8] = False  # unknown
    roomy = clearance(OccupancyGrid(np.zeros((7, 9), bool), free, 0.5), 1.0)
    assert np.argwhere(roomy).min(axis=0).tolist() == [2, 2]
    assert np.argwhere(roomy).max(axis=0).tolist() == [4, 5]


def test_clearance_at_a_corner_is_that_of_the_centre_less_half_a_cell():
    free = np.ones((5, 5), bool)
    free[0, 0] = False
    grid = OccupancyGrid(~free, free, 1.0)
    # The corner of the wall is 0.707 m from the centre of the cell beside it.
    assert clearance(grid, 0.9)[1, 1]
    assert not clearance(grid, 0.92)[1, 1]


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_radii_that_cannot_be_meant(radius):
    with pytest.raises(ConfigError, match="radius"):
        near(GridInfo(3, 3, 1.0), 0, 0, radius)


@pytest.fixture(scope="module")
def visibility():
    grid = render(WORLDS["visibility"](), 0.1)
    scans = simulate(grid, 3, 4, Sensor(), render(WORLDS["visibility"](), 0.01))
    return prepare(grid), scans


@pytest.mark.parametrize("method", ALL_METHODS)
def test_no_hypothesis_leaves_the_prior(visibility, method):
    features, scans = visibility
    x, y, theta = scans.poses[0]
    prior = Prior(near(features.grid.info, x, y, 1.5), (float(theta), 0.5))
    answer = localize(features, scans[0], Options(method, top=20, prior=prior))
    poses = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses])
    assert len(poses)
    slack = Prior(near(features.grid.info, x, y, 1.7), (float(theta), 0.6))
    assert slack.admits(poses, 0.1).all()
    assert np.hypot(poses[0, 0] - x, poses[0, 1] - y) < 0.3
    assert answer.parameters["prior"] == {}


def test_a_prior_makes_a_twin_impossible(visibility):
    features, scans = visibility
    free = localize(features, scans[0])
    assert free.verdict == "ambiguous"
    x, y, theta = scans.poses[0]
    known = Prior(near(features.grid.info, x, y, 2.0), (float(theta), 0.8), {"near": [x, y]})
    told = localize(features, scans[0], Options(prior=known))
    best, *others = told.hypotheses
    assert best.mass > 3 * free.hypotheses[0].mass
    assert sum(h.mass for h in others) < 0.01
    assert told.parameters["prior"] == {"near": [x, y]}
    assert np.hypot(best.pose.x - x, best.pose.y - y) < 0.1
    # What is left is that the scan shows nothing but a room, and that may be on no map.
    assert told.elsewhere > 0.05
    assert told.evidence.gained < 0


def test_what_would_be_crowded_out_is_found(visibility):
    features, scans = visibility
    few = FusedOptions(keep=(2, 2, 2, 2), second_look=1)
    x, y, theta = scans.poses[0]
    known = Prior(near(features.grid.info, x, y, 0.5), (float(theta), 0.2))
    without = localize(features, scans[0], Options(fused=few))
    told = localize(features, scans[0], Options(fused=few, prior=known))
    assert np.hypot(without.best.x - x, without.best.y - y) > 1  # a twin took the places
    assert np.hypot(told.pose.x - x, told.pose.y - y) < 0.1


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize(("radius", "tolerance"), [(0.01, 0.005), (0.05, 0.02)])
def test_a_tight_prior_beside_the_best_pose_is_no_mismatch(visibility, index, radius, tolerance):
    features, scans = visibility
    x, y, theta = scans.poses[index] + (0.08, -0.06, 0.03)  # as well as poses are known
    prior = Prior(near(features.grid.info, x, y, radius), (float(theta), tolerance))
    answer = localize(features, scans[index], Options(prior=prior))
    assert answer.verdict == "unique" or (index == 0 and answer.verdict == "ambiguous")  # a room
    assert abs(answer.best.theta - np.angle(np.exp(1j * theta))) < tolerance + 1e-6
    assert np.hypot(answer.best.x - x, answer.best.y - y) < radius + 0.1  # a cell


def closed_room(width: float, height: float, pose: tuple[float, float, float]) -> LaserScan:
    """A scan from within an empty rectangle: `pose` from its middle, 2 cm of noise."""
    x, y, theta = pose
    angles = np.deg2rad(np.arange(-180, 180, 2.0))
    dx, dy = np.cos(theta + angles), np.sin(theta + angles)
    ranges = np.minimum((np.sign(dx) * width / 2 - x) / dx, (np.sign(dy) * height / 2 - y) / dy)
    noise = 0.02 * np.random.default_rng(int(100 * width)).standard_normal(len(angles))
    return LaserScan(ranges + noise, angles, range_max=20.0)


@pytest.mark.parametrize(
    "known",
    [
        Known(),
        Known(clearance=0.3),
        Known(heading=(1.0, 0.5)),
        Known(near=(5.0, 7.0, 0.0, 3.0, 1.6)),
        Known(near=(5.0, 7.0, 0.0, RADIUS, TOLERANCE), sd=(0.5, 0.2)),
    ],
    ids=["nothing", "30 cm", "a heading", "a place", "a rough place"],
)
def test_what_is_known_lets_no_room_in_that_is_on_no_map(visibility, known):
    features, _ = visibility
    rooms = [
        (4.2, 3.1, (0.5, -0.3, 0.7)),
        (6.3, 3.7, (-1.0, 0.6, -2.0)),
        (2.9, 5.1, (0.2, 1.0, 2.9)),
    ]
    for room in rooms:
        answer = localize(
            features, closed_room(*room), Options(prior=prior_of(known, features.grid))
        )
        assert (answer.verdict, answer.pose) == ("no-match", None), room
        assert answer.best == answer.hypotheses[0].pose


def test_a_prior_without_a_pose_is_refused(visibility):
    features, scans = visibility
    nowhere = Prior(np.zeros(features.grid.occupied.shape, bool))
    with pytest.raises(ConfigError, match="leaves no cell"):
        localize(features, scans[0], Options(prior=nowhere))


SCANS = int(os.environ.get("IMGLOC_SCANS", "3"))
"""Scans of each world; tools/docs/measured/hints-2026-11-26.md has 67 of each."""


def off(answer, truth) -> bool:
    """Whether the best pose is beyond half a metre or 10 degrees."""
    away = pose_errors(poses_of(answer.hypotheses)[:1], Pose2D(*truth))
    return not len(away) or bool((away[0] > (0.5, np.deg2rad(10))).any())


def hostile(features, answer, truth, rng):
    """Priors by name: at the best place that is wrong, or at any, and at the right one."""
    poses, grid = poses_of(answer.hypotheses), features.grid
    away = (pose_errors(poses, Pose2D(*truth)) > (1.0, 0.3)).any(axis=1)
    free = np.argwhere(features.standable)[:, ::-1]
    anywhere = (*grid.resolution * (free[rng.integers(len(free))] + 0.5), rng.uniform(-3, 3))
    at = poses[away][0] if away.any() else np.array(anywhere)
    x, y = (np.arange(n) * grid.resolution for n in grid.occupied.shape[::-1])
    square = np.add.outer(np.square(y - at[1]), np.square(x - at[0]))
    rough = imgloc.near(features, *at, sd=(0.5, 0.17))
    return {
        "--near": imgloc.near(features, *at, radius=1.0, tolerance=0.4),
        "--near --sd": rough,
        "two hints": rough | imgloc.near(features, *poses[-1], sd=(1.0, 0.5), weight=0.3),
        "grey image": imgloc.region(features, np.maximum(np.exp(-square / 2), 0.01)),
        "black elsewhere": imgloc.region(features, (square < 2.25).astype(float)),
        "right hint": imgloc.near(features, *(truth + (0.2, 0.2, 0.05)), sd=(0.5, 0.17)),
    }


@pytest.mark.parametrize("name", ["corridor", "visibility", "double_wall"])
def test_no_weight_makes_a_wrong_pose_unique(name):
    features = prepare(imgloc.load_map(name))
    scans = simulate(features.grid, SCANS, 11, Sensor(range_max=6.0))
    rng, counts = np.random.default_rng(11), {}
    for scan, truth in zip(scans.scans, scans.poses, strict=True):
        plain = localize(features, scan)
        answers = {"none": plain}
        for key, prior in hostile(features, plain, truth, rng).items():
            answers[key] = localize(features, scan, Options(prior=prior))
        for key, answer in answers.items():
            wrong = off(answer, truth)
            verdict = answer.verdict + " and wrong" * (wrong and answer.verdict == "unique")
            counts.setdefault(key, Counter()).update([verdict, *["right first"] * (not wrong)])
            if key not in ("none", "--near") and answer.verdict == "unique":
                assert plain.verdict == "unique", key
                assert answer.best == plain.best, key
        black = answers["black elsewhere"]
        assert black.verdict != "unique" or not off(black, truth)
    print(*(f"{name} | {key} | {dict(some)}" for key, some in counts.items()), sep="\n")
    assert counts["right hint"]["right first"] >= counts["none"]["right first"]
    assert counts["right hint"]["unique"] == counts["none"]["unique"]


def test_hints_carry_their_doubt():
    grid = OccupancyGrid(np.zeros((4, 9), bool), np.ones((4, 9), bool), 1.0, Pose2D(5.0, 0.0))
    both = imgloc.near(grid, 6.5, 1.0, 0.0, sd=(0.5, 0.2)) | imgloc.near(
        grid, 13.0, 1.0, 3.0, sd=(0.5, 0.2), weight=0.5
    )
    assert [(one.x, one.weight) for one in both.hints[0]] == [(1.5, 1.0), (8.0, 0.5)]
    poses = np.array([[4.0, 1.0, 0.0], [8.0, 1.0, 3.0 - 2 * np.pi], [1.5, 1.5, 0.0]])
    order, share = ranked(both, poses, np.array([0.8, 0.1, 0.1]), 1.0)
    weights = np.array([0.8 * ASTRAY, 0.1 * 0.5, 0.1 * np.exp(-0.5)])
    assert order.tolist() == np.argsort(-weights).tolist()
    np.testing.assert_allclose(share, np.sort(weights / weights.sum())[::-1])
    assert not ranked(Prior(weights=np.zeros((4, 9))), poses, np.ones(3), 1.0)[1].any()
