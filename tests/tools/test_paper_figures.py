"""Figs. 1, 2, 4 and 5: what their stacks show, and that the panels show it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from imgloc import Picture, Pose2D
from tools.paper.figures import draw_comparison, draw_fields, ring, scene

RED, BLUE = (60, 20, 220), (178, 114, 0)


@pytest.fixture(scope="module")
def scenes():
    return {name: scene(name, threads=2) for name in ("fig1", "fig2", "fig4")}


def test_a_ring_leaves_what_is_in_it():
    image = np.full((200, 200, 3), 7, np.uint8)
    canvas = Picture(image, 100.0)
    assert ring(canvas, Pose2D(1.0, 1.0, 0.0)) is canvas
    assert (image[100, 100] == 7).all()  # the pose itself
    red = (image == RED).all(axis=2)
    rows, columns = np.nonzero(red)
    assert abs(rows.mean() - 100) < 2
    assert columns.max() - 100 > 100 - columns.min()  # the nose points along +x


def test_fields_have_arrows_and_six_panels(scenes):
    image = draw_fields(scenes["fig4"])
    assert image.shape[1] > 2.5 * 60 * 9  # three panels of 60 cells
    saturation = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[..., 1]
    assert (saturation > 100).mean() > 0.02  # directions are colours


def test_comparisons_mark_the_pose_in_each_panel(scenes):
    s = scenes["fig2"]
    image = draw_comparison(s, scale=2)
    red = (image == RED).all(axis=2).astype(np.uint8)
    count = cv2.connectedComponents(cv2.dilate(red, np.ones((5, 5), np.uint8)))[0] - 1
    assert count == 2 + len(s.stacks)


def test_a_maximum_is_marked_where_it_is_not_the_true_pose(scenes):
    s = scenes["fig2"]
    marked = []
    for truth in (s.truth, Pose2D(s.truth.x + 2.0, s.truth.y, s.truth.theta)):
        image = draw_comparison(replace(s, truth=truth), scale=2)
        blue = (image == BLUE).all(axis=2).astype(np.uint8)
        marked.append(cv2.connectedComponents(cv2.dilate(blue, np.ones((5, 5), np.uint8)))[0] - 1)
    assert marked == [0, len(s.stacks)]
