"""Messages for robots: under AMCL's rules, readable by another program."""

import numpy as np
import pytest
import yaml

from imgloc import Belief, Moment, OutputError, Pose2D
from imgloc.geometry import transform_poses
from imgloc.output.ros import (
    ARRAY,
    GUESSES,
    POSE,
    Message,
    containing_diagonal,
    message,
    write_bag,
    yaml_text,
)

ORIGIN = Pose2D(-3.0, 2.0, 0.5)
COVARIANCE = np.array([[0.04, -0.03, 0.001], [-0.03, 0.09, 0.002], [0.001, 0.002, 0.01]])


def moment(verdict: str, stamp: float = 12.25) -> Moment:
    poses = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, -1.0]])
    belief = Belief(poses, np.array([0.6, 0.4]), np.tile(COVARIANCE, (2, 1, 1)), 0.0, verdict, 2.0)
    best = Pose2D(*transform_poses(ORIGIN, poses)[0])
    return Moment(
        index=3, stamp=stamp, age=0.0, looked=True, metres=1.0, belief=belief, withheld="",
        best=best, covariance=COVARIANCE, deviation=(0.1, 0.01), map_odom=None,
    )  # fmt: skip


def test_the_diagonal_contains_the_ellipse() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        A = rng.normal(size=(3, 3)) * [1, 0.3, 0.01]
        C = A.T @ A
        D = np.diag(containing_diagonal(C))
        assert np.linalg.eigvalsh(D - C).min() > -1e-12
        assert np.trace(D) <= 3 * np.trace(C) + 1e-12


def test_a_unique_pose_is_what_amcl_takes() -> None:
    kind, body, guess = message(moment("unique"), ORIGIN) or Message("", {})
    assert not guess
    assert kind == POSE
    assert body["header"]["frame_id"] == "map"
    assert body["header"]["stamp"] == {"sec": 12, "nanosec": 250_000_000}
    q = body["pose"]["pose"]["orientation"]
    assert sum(v * v for v in q.values()) == pytest.approx(1, abs=1e-9)
    covariance = np.array(body["pose"]["covariance"])
    assert covariance.shape == (36,)
    assert ((covariance >= 0) & (covariance <= 1e9)).all()
    assert covariance[[0, 7, 35]].tolist() == containing_diagonal(COVARIANCE).tolist()


def test_several_places_are_an_array_unless_the_best_is_asked_for() -> None:
    kind, body, _ = message(moment("ambiguous"), ORIGIN) or Message("", {})
    assert kind == ARRAY
    assert len(body["poses"]) == 2
    expected = transform_poses(ORIGIN, np.array([[4.0, 5.0, -1.0]]))[0]
    assert body["poses"][1]["position"]["x"] == pytest.approx(expected[0])
    for verdict in ("ambiguous", "lost"):
        guessed = message(moment(verdict), ORIGIN, best=True) or Message("", {})
        assert (guessed.kind, guessed.guess) == (POSE, True)
        assert yaml_text([guessed]).startswith(f"# {POSE}, a guess\n")
    assert message(moment("lost"), ORIGIN) is None


def test_yaml_is_read_back() -> None:
    messages = [m for v in ("unique", "ambiguous", "lost") if (m := message(moment(v), ORIGIN))]
    read = [d for d in yaml.safe_load_all(yaml_text(messages)) if d]
    assert read == [one.body for one in messages]


def test_a_bag_is_read_back_by_rosbags(tmp_path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="needs the extra ros")
    messages = [
        m
        for k, v in enumerate(("unique", "ambiguous"))
        if (m := message(moment(v, 5.5 + k), ORIGIN))
    ]
    path = tmp_path / "out.bag"
    guess = message(moment("lost", 7.5), ORIGIN, best=True)
    assert guess is not None
    write_bag(path, [*messages, guess])
    with highlevel.AnyReader([path]) as bag:
        got = [(c.topic, t, bag.deserialize(raw, c.msgtype)) for c, t, raw in bag.messages()]
    assert [(topic, t) for topic, t, _ in got] == [
        ("/initialpose", 5_500_000_000), ("/imgloc/hypotheses", 6_500_000_000),
        (GUESSES, 7_500_000_000),
    ]  # fmt: skip
    body = messages[0][1]["pose"]
    assert got[0][2].pose.pose.position.x == body["pose"]["position"]["x"]
    np.testing.assert_array_equal(got[0][2].pose.covariance, body["covariance"])
    assert len(got[1][2].poses) == 2
    with pytest.raises(OutputError, match="exists"):
        write_bag(path, messages)
