"""`imgloc serve`: the real process on loopback, asked by good clients and by bad ones."""

import asyncio
import base64
import io
import json
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from badfiles import YAML, png, room
from command import MAPS, call, rows, simulating, spawn, untimed
from places import drive, lines_of
from serving import Served, memory, served, waits
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import imgloc
from imgloc.lab.atlas import survey_part
from imgloc.live.server import bound

MAP = MAPS / "visibility.yaml"
STILL = {"ranges": [3.0] * 90, "angle_min": -3.1, "angle_increment": 0.07, "range_max": 30.0,
         "odom": [0, 0, 0]}  # fmt: skip
LINE = json.dumps(STILL)


scans = simulating(MAP, "-n", 3, "--seed", 4)


@pytest.fixture(scope="module")
def service() -> Iterator[Served]:
    with served(MAP, MAPS / "curved.yaml") as one:
        yield one


@pytest.fixture(scope="module")
def impatient() -> Iterator[Served]:
    """A service with one map, whose patience ends within a test."""
    with served(MAP, "--patience", 1) as one:
        yield one


@pytest.fixture
def http(service: Served) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.address, timeout=60) as client:
        yield client


def problem(answer: httpx.Response, status: int, kind: str) -> str:
    """Check a problem document, and return what it says."""
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    said = answer.json()
    assert (answer.status_code, said["type"]) == (status, f"urn:imgloc:problem:{kind}"), said
    assert said["status"] == status
    assert said["title"]
    return str(said["detail"])


def answers(text: str) -> list[str]:
    """The rows of answers as `imgloc localize` prints them: without the map that they are of."""
    row, of = re.compile(r', "map": "[^"]+", "version": "[0-9a-f]{40}"\}$', re.M), "}"
    assert len(row.findall(text)) == len(text.splitlines())
    return untimed(row.sub(of, text))


def laser_scan(scans: Path, k: int) -> dict[str, Any]:
    scan = imgloc.load_scans(scans)[k]
    ranges = [r if np.isfinite(r) else "inf" for r in scan.ranges.tolist()]
    return {"ranges": ranges, "angles": scan.angles.tolist(), "range_max": scan.range_max}


# Answers.


@pytest.mark.parametrize(
    ("options", "asked"),
    [
        ([], {}),
        (["--scans-index", "1"], {"index": "1"}),
        (["--top", "2", "--range-max", "8", "--sensor", "0.1,0,3"],
         {"top": 2, "range_max": 8, "sensor": "0.1,0,3"}),
        (["--near", "4,7,0.5,3"], {"near": "4,7,0.5,3"}),
        (["--heading", "1", "--clearance", "0.2"], {"heading": "1", "clearance": 0.2}),
        (["--method", "cbml", "--theta-step-deg", "9", "--scans-index", "0"],
         {"method": "cbml", "theta_step_deg": 9, "index": "0"}),
        (["--scans-index", "2", "--flipped"], {"index": "2", "flipped": "true"}),
    ],
)  # fmt: skip
def test_an_answer_is_what_localize_prints(http, scans, options, asked):
    here = call("localize", MAP, scans, "--json", *options)
    there = http.post("/v1/localize", params={"map": "visibility", **asked},
                      content=scans.read_bytes())  # fmt: skip
    assert there.status_code == 200, there.text
    assert answers(there.text) == untimed(here.out)
    lines = len(here.out.splitlines())
    kind = "application/json" if lines == 1 else "application/x-ndjson"
    assert there.headers["content-type"] == kind


def test_which_is_what_which_prints(http: httpx.Client, scans: Path, tmp_path: Path) -> None:
    for name in ("visibility", "curved"):
        for ending in (".yaml", ".png"):
            (tmp_path / f"{name}{ending}").write_bytes((MAPS / f"{name}{ending}").read_bytes())
    here = call("which", tmp_path, scans, "--json")
    there = http.post("/v1/which", content=scans.read_bytes())
    assert there.text == here.out


def test_a_robot_is_followed_as_track_does(service: Served, tmp_path: Path) -> None:
    lines = lines_of(drive(np.array([[4.0 + 0.5 * k, 7.0, 0.0] for k in range(6)])))
    (tmp_path / "log.jsonl").write_text("".join(lines))
    here = call("track", MAP, tmp_path / "log.jsonl", "--json")
    address = f"{service.track}?map=visibility&places=true"
    with connect(address) as socket:
        there = []
        for line in lines:
            socket.send(line)
            there.append(socket.recv(timeout=60))
    assert there == here.out.splitlines()
    assert json.loads(there[-1])["verdict"] == "unique"


# Maps and scans that clients send.


def test_a_robot_that_says_nothing_for_long_is_followed_on(impatient: Served) -> None:
    with connect(impatient.track) as robot:
        for index in range(3):
            robot.send(LINE)
            assert json.loads(robot.recv(60))["index"] == index
            time.sleep(1.5)


def test_a_map_that_is_sent_answers_as_the_file_does(http: httpx.Client, scans: Path) -> None:
    files = {"image": ("visibility.png", (MAPS / "visibility.png").read_bytes()),
             "yaml": ("visibility.yaml", MAP.read_bytes())}  # fmt: skip
    sent = http.post("/v1/maps?name=visibility", files=files)
    assert sent.status_code == 201, sent.text
    about, id_ = sent.json(), sent.json()["id"]
    assert sent.headers["location"] == f"/v1/maps/{id_}"
    said = http.get("/v1/maps/visibility").json()
    assert about == {**said, "id": id_, "uploaded": True, "path": None}
    assert http.get(f"/v1/maps/{id_}").json() == about
    assert (said["id"], said["name"], said["uploaded"]) == ("visibility", "visibility", False)
    both = [http.post(f"/v1/localize?map={name}", content=scans.read_bytes()).text
            for name in (id_, "visibility")]  # fmt: skip
    assert answers(both[0]) == answers(both[1])
    for name, text in zip((id_, "visibility"), both, strict=True):
        of = [(row["map"], row["version"]) for row in rows(text)]
        assert of == [(name, about["version"])] * 3
    assert http.delete(f"/v1/maps/{id_}").status_code == 204
    problem(http.get(f"/v1/maps/{id_}"), 404, "not-found")
    problem(http.delete("/v1/maps/visibility"), 409, "name-taken")


def upload(address: str, name: str, of: str) -> httpx.Response:
    """Send one of the bundled maps under a name."""
    files = {"image": (f"{of}.png", (MAPS / f"{of}.png").read_bytes()),
             "yaml": (f"{of}.yaml", (MAPS / f"{of}.yaml").read_bytes())}  # fmt: skip
    return httpx.post(f"{address}/v1/maps", params={"name": name}, files=files, timeout=60)


def test_a_map_that_is_sent_is_its_sender_s(service: Served, http: httpx.Client) -> None:
    one, other = (upload(service.address, "mine", of).json() for of in ("curved", "visibility"))
    assert one["name"] == other["name"] == "mine"
    assert one["version"] != other["version"]
    assert http.get(f"/v1/maps/{one['id']}").json() == one
    problem(http.get("/v1/maps/mine"), 404, "not-found")  # by its id alone
    names = [there["id"] for there in http.get("/v1/maps").json()["maps"]]
    assert names == ["visibility", "curved"]
    said = problem(http.get("/v1/maps/nowhere"), 404, "not-found")
    assert one["id"] not in said
    assert http.delete(f"/v1/maps/{other['id']}").status_code == 204
    assert http.get(f"/v1/maps/{one['id']}").json() == one
    assert http.delete(f"/v1/maps/{one['id']}").status_code == 204


def test_a_map_outlives_many_uploads_while_a_robot_is_followed_in_it(service, http):
    id_ = upload(service.address, "followed", "curved").json()["id"]
    small = cv2.imencode(".png", room())[1].tobytes()
    others = list[str]()
    with connect(f"{service.track}?map={id_}") as robot:
        robot.send(LINE)
        assert json.loads(robot.recv(60))["index"] == 0
        detail = problem(http.delete(f"/v1/maps/{id_}"), 409, "in-use")
        assert "a robot is followed in it" in detail
        for _ in range(20):  # others' maps make room for one another, not for this one
            sent = http.post("/v1/maps?name=a&resolution=0.1", content=small)
            assert sent.status_code == 201, sent.text
            others.append(sent.json()["id"])
        robot.send(LINE)
        assert json.loads(robot.recv(60))["index"] == 1
    assert http.get(f"/v1/maps/{id_}").status_code == 200
    assert http.get(f"/v1/maps/{others[0]}").status_code == 404
    waits(lambda: http.delete(f"/v1/maps/{id_}").status_code == 204)


def test_an_uploaded_map_changes_no_answer_to_those_who_name_no_map(impatient, scans) -> None:
    def asked(what: str, **more: str) -> str:
        answer = httpx.post(f"{impatient.address}/v1/{what}", params={"index": "1", **more},
                            content=scans.read_bytes(), timeout=60)  # fmt: skip
        assert answer.status_code == 200, answer.text
        return answer.text

    before = asked("localize"), asked("which")
    id_ = upload(impatient.address, "stranger", "visibility").json()["id"]
    assert untimed(asked("localize")) == untimed(before[0])
    assert asked("which") == before[1]
    with connect(impatient.track) as robot:
        robot.send(LINE)
        assert json.loads(robot.recv(60))["index"] == 0
    assert answers(asked("localize", map=id_)) == answers(before[0])


def test_without_a_map_of_the_service_one_is_named_by_its_id(scans: Path) -> None:
    with served() as one:
        body, asked = scans.read_bytes(), f"{one.address}/v1/localize?index=1"
        id_ = upload(one.address, "a", "visibility").json()["id"]
        answer = httpx.post(asked, content=body, timeout=60)
        assert problem(answer, 422, "bad-options").endswith("map: missing, expected the id of one")
        assert httpx.post(f"{asked}&map={id_}", content=body, timeout=60).status_code == 200
        answer = httpx.post(f"{one.address}/v1/which?index=1", content=body, timeout=60)
        assert "the service has no map" in problem(answer, 404, "not-found")


def test_a_map_as_image_is_the_one_that_was_sent(http: httpx.Client) -> None:
    image = cv2.imdecode(np.frombuffer(http.get("/v1/maps/curved/image").content, np.uint8),
                         cv2.IMREAD_UNCHANGED)  # fmt: skip
    grid = imgloc.load_map(MAPS / "curved.yaml")
    assert ((image == 0) == grid.occupied[::-1]).all()
    assert ((image == 254) == grid.free[::-1]).all()


def test_a_form_that_is_cut_says_so(http: httpx.Client) -> None:
    head = 'Content-Disposition: form-data; name="file"; filename="a.jsonl"'
    body = f'--x\r\n{head}\r\n\r\n{{"ranges": [1, 2], "angle_min": 0}}\r\n--x--\r\n'.encode()
    form = {"Content-Type": "multipart/form-data; boundary=x"}
    for size in (len(body) - 4, len(body) // 2, 20):
        for path in ("localize?map=curved", "maps"):
            said = http.post(f"/v1/{path}", content=body[:size], headers=form)
            assert "the form is cut" in problem(said, 400, "bad-request")


def test_what_the_parser_of_forms_logs_is_not_printed() -> None:
    code = (
        "from imgloc.live.requests import parts_of\n"
        "try: parts_of(b'--y', 'multipart/form-data; boundary=x')\n"
        "except Exception as e: print(e)"
    )
    run = spawn(code=code).ends(0)
    assert "is no form" in run.out
    assert run.err == ""


@pytest.mark.parametrize("path", ["/etc/passwd", "../../../etc/passwd", "C:\\\\boot.ini"])
def test_no_path_in_a_yaml_is_opened(http: httpx.Client, path: str) -> None:
    ok, image = cv2.imencode(".png", room())
    assert ok
    yaml = YAML.replace("good.png", json.dumps(path))
    files = {"image": ("good.png", image.tobytes()), "yaml": ("m.yaml", yaml.encode())}
    said = problem(http.post("/v1/maps", files=files), 422, "bad-map")
    assert "it is of" in said
    assert "good.png" in said
    files["image"] = (path.replace("\\\\", "\\").split("/")[-1], image.tobytes())
    sent = http.post("/v1/maps?name=named", files=files)
    assert sent.status_code == 201  # it is this image
    assert http.delete(sent.headers["location"]).status_code == 204


@pytest.mark.parametrize("name", ["../up", "a/b", "<img src=x onerror=alert(1)>", "", "x" * 101])
def test_a_map_has_a_plain_name(http: httpx.Client, name: str) -> None:
    files = {"image": ("good.png", b"\x89PNG")}
    answer = http.post("/v1/maps", params={"name": name, "resolution": 0.1}, files=files)
    assert "name: got" in problem(answer, 400, "bad-parameter")


def test_scans_that_are_sent_are_read_back_as_they_were(http: httpx.Client, scans: Path) -> None:
    sent = http.post("/v1/scans?name=scans.npz", content=scans.read_bytes())
    assert sent.status_code == 201, sent.text
    about, kept = sent.json(), imgloc.load_scans(scans)
    assert (about["scans"], about["poses"], about["odom"]) == (3, True, False)
    page = http.get(f"/v1/scans/{about['id']}", params={"start": 1, "count": 2}).json()
    assert [item["index"] for item in page["items"]] == [1, 2]
    item = page["items"][0]
    same = [float("nan") if r is None else float(r) for r in item["ranges"]]
    np.testing.assert_array_equal(same, kept[1].ranges)
    np.testing.assert_array_equal(item["angles"], kept[1].angles)
    assert list(item["pose"].values()) == kept.poses[1].tolist()
    by_id = http.post(f"/v1/localize?map=visibility&scans={about['id']}&index=1").text
    by_item = http.post("/v1/localize?map=visibility", json=item).json()
    assert untimed(by_id)[0] == untimed(json.dumps({**by_item, "index": 1}))[0]
    assert http.delete(f"/v1/scans/{about['id']}").status_code == 204
    problem(http.post(f"/v1/localize?map=visibility&scans={about['id']}"), 404, "not-found")


@pytest.mark.parametrize("end", [0.6, 0.999])
def test_a_file_that_is_cut_is_answered_without_its_last_line_and_says_so(
    service: Served, http: httpx.Client, scans: Path, tmp_path: Path, end: float
) -> None:
    lines = [json.dumps(laser_scan(scans, k)) for k in range(3)]
    cut = "\n".join([*lines[:2], lines[2][: int(end * len(lines[2]))]])
    (tmp_path / "sent.jsonl").write_text(cut)
    printed = call("localize", MAP, tmp_path / "sent.jsonl", "--json")
    (said,) = [line for line in printed.err.splitlines() if "cut off" in line]
    expected = ["sent.jsonl: line 3: the last line was cut off and is left out"]
    assert expected[0] in said
    ask = {"content": cut, "params": {"map": "visibility", "name": "sent.jsonl"}}
    rows = [json.loads(line) for line in http.post("/v1/localize", **ask).text.splitlines()]
    assert [row["warnings"] for row in rows] == [expected, expected]
    raw = http.post("/v1/localize?map=visibility", content=cut).text.splitlines()
    assert [json.loads(line)["warnings"] for line in raw] == [
        ["body: line 3: the last line was cut off and is left out"]
    ] * 2
    which = http.post("/v1/which", content=cut, params={"name": "sent.jsonl"}).text.splitlines()
    assert [json.loads(line)["warnings"] for line in which] == [expected, expected]
    held = http.post("/v1/scans?name=sent.jsonl", content=cut).json()
    assert (held["scans"], held["warnings"]) == (2, expected)
    at = {"map": "visibility", "scans": held["id"], "index": 1, "pose": "4,7,0"}
    assert http.post("/v1/score", params=at).json()["warnings"] == expected
    whole = http.post("/v1/scans?name=sent.jsonl", content="\n".join(lines)).json()
    assert (whole["scans"], whole["warnings"]) == (3, [])
    one = http.post(f"/v1/localize?map=visibility&scans={whole['id']}&index=0").json()
    assert "warnings" not in one


# How a scan fits, and layers.


def test_a_pose_is_scored_as_the_answer_has_it_and_settles_where_the_answer_is(http, scans):
    body = scans.read_bytes()
    asked = {"map": "visibility", "index": "0"}
    best = http.post("/v1/localize", params=asked, content=body).json()["hypotheses"][0]
    pose = [best[key] for key in ("x", "y", "theta")]
    at = {**asked, "pose": ",".join(map(repr, pose))}
    fit = http.post("/v1/score", params=at, content=body).json()
    assert fit["log_likelihood"] == pytest.approx(
        best["log_likelihood"], abs=5.0
    )  # of the best of its maxima, not their mean
    assert sum(fit["counts"].values()) == len(fit["rays"]["kind"]) == len(fit["rays"]["end"])
    assert fit["counts"]["agrees"] > 0.9 * len(fit["rays"]["kind"])
    rays = zip(*(fit["rays"][key] for key in ("kind", "end", "distance")), strict=True)
    for kind, end, distance in rays:
        assert (end is None) == (distance is None)
        assert kind != "agrees" or distance < 0.5 < 1 + distance
    for x, y, turn in ((0.2, -0.15, 0.05), (-0.3, 0.2, -0.15), (0.0, 0.35, 0.12), (0.3, 0.2, 0.1)):
        off = {**asked, "pose": f"{pose[0] + x},{pose[1] + y},{pose[2] + turn}"}
        moved = http.post("/v1/score", params=off, content=body).json()
        assert moved["misfit"] > fit["misfit"] + 0.5
        settled = http.post("/v1/settle", params=off, content=body).json()
        assert settled["log_likelihood"] > fit["log_likelihood"] - 0.5
        assert [settled["pose"][k] for k in "xy"] == pytest.approx(pose[:2], abs=0.1)


def test_layers_lie_over_the_map(http: httpx.Client, scans: Path) -> None:
    features = imgloc.prepare(imgloc.load_map(MAP))
    answer = http.get("/v1/layers/bmap?map=visibility")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image[::-1], np.rint(255 * features.bmap))
    assert float(answer.headers["imgloc-resolution"]) == features.lattice.resolution
    sent = http.post("/v1/scans", content=scans.read_bytes()).json()["id"]
    asked = {"map": "visibility", "scans": sent, "index": "1", "method": "cbml"}
    answer = http.get("/v1/layers/likelihood", params={**asked, "slice": "7"})
    stack = imgloc.likelihood(features, imgloc.load_scans(scans)[1], "cbml")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    wanted = np.rint(255 * stack.values[7] / stack.values.max())
    assert np.abs(image[::-1] - wanted).max() <= 1
    assert int(answer.headers["imgloc-slices"]) == len(stack.thetas)
    assert float(answer.headers["imgloc-theta"]) == pytest.approx(stack.thetas[7])
    seen = http.get("/v1/layers/visibility?map=visibility&at=4,7").json()
    assert len(seen["polygon"]) == 360
    for what in ("vmap", "distance"):
        answer = http.get(f"/v1/layers/{what}?map=visibility")
        assert answer.headers["content-type"] == "image/png"


def test_an_atlas_is_that_of_the_laser_of_a_scan(http: httpx.Client, scans: Path) -> None:
    id_ = http.post("/v1/scans?name=a.npz", content=scans.read_bytes()).json()["id"]
    asked = {"map": "curved", "scans": id_, "index": "1", "step": 5, "headings": 2}
    part = http.get("/v1/layers/atlas", params=asked).json()
    spots = [*part["spots"]]
    while part["next"] is not None:
        assert part["next"] == len(spots)
        part = http.get("/v1/layers/atlas", params={**asked, "start": part["next"]}).json()
        spots += part["spots"]
    assert len(spots) == part["of"] > 4
    features, scan = (
        imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml")),
        imgloc.load_scans(scans)[1],
    )
    whole = survey_part(features, scan, imgloc.Options(), step=5.0, headings=2, seconds=1e9)
    assert spots == whole["spots"]
    wrong = http.get("/v1/layers/atlas", params={**asked, "start": len(spots)})
    assert "start" in problem(wrong, 422, "bad-options")
    no_scan = http.get("/v1/layers/atlas?map=curved")
    assert "scans: missing" in problem(no_scan, 400, "bad-parameter")


def test_marked_scans_come_back_with_their_poses(http, scans, tmp_path):
    id_ = http.post("/v1/scans?name=a.npz", content=scans.read_bytes()).json()["id"]
    given = [[2, 1.5, -2.0, 0.25], [0, 3, 4, -3]]
    answer = http.post(f"/v1/scans/{id_}/marked", json={"poses": given})
    assert answer.status_code == 200, answer.text
    (tmp_path / "marked.npz").write_bytes(answer.content)
    marked, whole = imgloc.load_scans(tmp_path / "marked.npz"), imgloc.load_scans(scans)
    assert marked.poses.tolist() == [[1.5, -2.0, 0.25], [3.0, 4.0, -3.0]]
    for one, k in zip(marked.scans, (2, 0), strict=True):
        np.testing.assert_array_equal(one.ranges, whole[k].ranges)
    for rows_, said in (
        ([], "0 to 2"), ([[3, 0, 0, 0]], "0 to 2"), ([[-1, 0, 0, 0]], "0 to 2"),
        ([[0, 0, 0, 0], [0, 1, 1, 1]], "each once"),
    ):  # fmt: skip
        bad = http.post(f"/v1/scans/{id_}/marked", json={"poses": rows_})
        assert said in problem(bad, 422, "bad-scan"), rows_
    for row, said in (([0, 0, None, 0], "0.2"), ([0, 0, 0], "poses.0"), ([0.5, 0, 0, 0], "0.0")):
        bad = http.post(f"/v1/scans/{id_}/marked", json={"poses": [row]})
        assert said in problem(bad, 400, "bad-request"), row
    nothing = http.post(f"/v1/scans/{'0' * 32}/marked", json={"poses": given})
    problem(nothing, 404, "not-found")


def test_a_region_is_that_of_the_command_line(http, scans, tmp_path):
    region = "1,1,12,1,12,9,1,9"
    image = http.get(f"/v1/layers/region?map=visibility&region={region}")
    (tmp_path / "region.png").write_bytes(image.content)
    here = call("localize", MAP, scans, "--json", "--region", tmp_path / "region.png")
    there = http.post(f"/v1/localize?map=visibility&region={region}", content=scans.read_bytes())
    assert answers(there.text) == untimed(here.out)


def test_what_may_be_wrong_is_that_of_the_command_line(http: httpx.Client, scans: Path) -> None:
    here = call("localize", MAP, scans, "--json", "--near", "3,2,0.5", "--sd", "0.5,0.2")
    ask = "/v1/localize?map=visibility&"
    there = http.post(f"{ask}near=3,2,0.5&sd=0.5,0.2", content=scans.read_bytes())
    assert answers(there.text) == untimed(here.out)
    hinted = http.post(f"{ask}hints=3,2,0.5,0.5,0.2,1", content=scans.read_bytes())
    masses = [
        [[h["mass"] for h in json.loads(line)["hypotheses"]] for line in one.text.splitlines()]
        for one in (there, hinted)
    ]
    assert masses[0] == masses[1]
    bad = http.post(f"{ask}hints=3,2,0.5,0.5,0.2,1,7", content=scans.read_bytes())
    assert "expected six for each pose" in problem(bad, 422, "bad-options")


# What is wrong is said, as a problem document.


@pytest.mark.parametrize(
    ("path", "body", "status", "kind", "said"),
    [
        ("/v1/localize?map=visibility", b"", 422, "bad-scan", "empty"),
        ("/v1/localize?map=nowhere", b"{}", 404, "not-found", "curved"),
        ("/v1/localize", b"1,2\n", 422, "bad-options", "map: missing"),
        ("/v1/localize?map=visibility&method=best", b"1", 400, "bad-parameter", "fused"),
        ("/v1/localize?map=visibility&foo=1", b"1", 400, "bad-parameter", "foo"),
        ("/v1/localize?map=visibility&top=1&top=2", b"1", 400, "bad-parameter", "twice"),
        ("/v1/localize?map=visibility&near=1,2,90", b"1", 400, "bad-parameter", "-6.2832"),
        ("/v1/localize?map=visibility&index=9", None, 422, "bad-options", "0 to 2"),
        ("/v1/localize?map=visibility&near=900,900,0", None, 422, "bad-options", "no cell"),
        ("/v1/localize?map=visibility", b"hello", 422, "bad-scan", "body"),
        ("/v1/localize?map=visibility&name=a.npz", b"PK\3\4", 422, "bad-scan", "a.npz"),
        ("/v1/maps?name=a", b"GIF89a", 422, "bad-map", "resolution"),
        ("/v1/maps?name=a&resolution=0.1", b"GIF89a", 422, "bad-map", "GIF"),
        ("/v1/score?map=visibility", None, 400, "bad-parameter", "pose: missing"),
        ("/v1/nothing", b"", 404, "not-found", "openapi"),
        ("/healthz", b"", 405, "method-not-allowed", "GET"),
    ],
)  # fmt: skip
def test_a_wrong_request_is_told_what_is_wrong(http, scans, path, body, status, kind, said):
    content = scans.read_bytes() if body is None else body
    assert said in problem(http.post(path, content=content), status, kind)


# Hostile clients.


def bombs() -> dict[str, tuple[str, bytes]]:
    """Small bodies that would become large."""
    npz = io.BytesIO()
    with zipfile.ZipFile(npz, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        shape = {"descr": "<f8", "fortran_order": False, "shape": (400_000, 100)}
        np.lib.format.write_array_header_1_0(head, shape)
        archive.writestr("ranges.npy", head.getvalue() + bytes(1 << 26))
    wide = png(30_000, 30_000, 8, 0, [], idat=b"")
    return {
        "npz": ("/v1/localize?map=visibility&name=a.npz", npz.getvalue()),
        "png": ("/v1/maps?name=bomb&resolution=0.05", wide),
        "json": ("/v1/localize?map=visibility&name=a.json", b"[" * 1_000_000),
        "csv": ("/v1/localize?map=visibility&name=a.csv", b"1," * 20_000_000),
        "lines": ("/v1/localize?map=visibility&name=a.jsonl", b"\n" * 30_000_000),
    }


@pytest.mark.parametrize("name", ["npz", "png", "json", "csv", "lines"])
def test_a_bomb_is_refused_before_it_is_unpacked(service, http, name):
    path, body = bombs()[name]
    before = memory(service, "VmHWM")
    answer = http.post(path, content=body)
    assert answer.status_code in (413, 422), answer.text
    assert memory(service, "VmHWM") - before < 300
    assert http.get("/healthz").status_code == 200


def raw(port: int, text: bytes, *, end: bool = False) -> bytes:
    """Send bytes, and return all that comes back until the other side closes."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as one:
        one.sendall(text)
        if end:
            one.shutdown(socket.SHUT_WR)
        out = b""
        while part := one.recv(1 << 16):
            out += part
        return out


def post(port: int, length: int, more: str = "") -> bytes:
    head = f"POST /v1/localize?map=visibility HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{more}"
    return f"{head}Content-Length: {length}\r\n\r\n".encode()


def test_two_gigabytes_are_refused_by_their_length(service: Served, http: httpx.Client) -> None:
    out = raw(service.port, post(service.port, 2 << 30) + b"x" * 100_000)
    assert out.startswith(b"HTTP/1.1 413 ")
    assert b"urn:imgloc:problem:too-large" in out
    assert http.get("/healthz").status_code == 200


def test_a_body_without_an_end_is_refused_when_it_is_too_long(service: Served) -> None:
    head = (
        f"POST /v1/scans HTTP/1.1\r\nHost: 127.0.0.1:{service.port}\r\n"
        "Transfer-Encoding: chunked\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", service.port), timeout=60) as one:
        one.sendall(head.encode())
        chunk = b"100000\r\n" + bytes(1 << 20) + b"\r\n"
        sent = 0
        try:
            while sent < 20_000:
                one.sendall(chunk)
                sent += 1
        except OSError:
            pass
        assert 60 < sent < 20_000
        assert one.recv(100).startswith(b"HTTP/1.1 413 ")


def test_half_a_head_half_a_body_and_nonsense_cost_nothing(impatient: Served) -> None:
    port = impatient.port
    assert raw(port, b"GET / HT") == raw(port, b"") == b""
    assert raw(port, post(port, 1000) + b"{").startswith(b"HTTP/1.1 408 ")
    assert raw(port, b"\0\1\2 hello\r\n\r\n").startswith(b"HTTP/1.1 400 ")
    assert raw(port, post(port, -5)).startswith(b"HTTP/1.1 400 ")
    assert raw(port, post(port, 100) + b"{", end=True) == b""
    assert httpx.get(f"{impatient.address}/healthz").status_code == 200


@pytest.mark.parametrize(
    ("headers", "kind"),
    [
        ({"Host": "evil.example"}, "forbidden"),
        ({"Host": "evil.example:80@127.0.0.1"}, "forbidden"),
        ({"Origin": "http://evil.example"}, "forbidden"),
        ({"Origin": "null"}, "forbidden"),
        ({"Origin": "http://127.0.0.1:1"}, "forbidden"),
        ({"Sec-Fetch-Site": "cross-site"}, "forbidden"),
    ],
)
def test_pages_of_other_sites_are_refused(service, http, headers, kind):
    problem(http.get("/v1/maps", headers=headers), 403, kind)
    if "Host" not in headers:
        with pytest.raises(Exception, match="403"):
            connect(f"{service.track}?map=curved",
                    additional_headers=headers)  # fmt: skip


def test_the_page_itself_and_localhost_are_not(service: Served, http: httpx.Client) -> None:
    own = {"Origin": service.address, "Sec-Fetch-Site": "same-origin"}
    assert http.get("/v1/maps", headers=own).status_code == 200
    named = {"Host": f"localhost:{service.port}"}
    assert http.get("/v1/maps", headers=named).status_code == 200


def test_every_answer_says_what_a_page_may_do(http: httpx.Client) -> None:
    for path in ("/healthz", "/v1/maps", "/v1/nothing", "/"):
        headers = http.get(path).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in headers


def test_others_reach_it_by_a_token_alone(scans: Path) -> None:
    refused = call("serve", MAP, "--host", "0.0.0.0", "--port", 0)
    assert refused.code == 2
    assert "token" in refused.err
    assert call("serve", MAP, "--host", "0.0.0.0", "--token", "short").code == 2
    token = "a-token-of-some-length"
    with served(MAP, "--host", "0.0.0.0", IMGLOC_TOKEN=token) as one:
        assert one.address == f"http://0.0.0.0:{one.port}"
        said = one.process.stderr.readline()
        there = f"http://{socket.gethostname()}:{one.port}/#token=TOKEN"
        assert there in said
        assert token not in said
        at = f"http://127.0.0.1:{one.port}"
        for given in ({}, {"Authorization": "Bearer no"}, {"Authorization": token}):
            answer = httpx.post(f"{at}/v1/localize", content=scans.read_bytes(), headers=given)
            assert answer.headers["www-authenticate"] == "Bearer"
            problem(answer, 401, "unauthorized")
        assert httpx.get(f"{at}/healthz").status_code == 200
        own = {"Authorization": f"Bearer {token}"}
        assert httpx.get(f"{at}/v1/maps", headers=own).status_code == 200
        with pytest.raises(Exception, match="401"):
            connect(one.track)
        word = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
        with connect(one.track,
                     subprotocols=["imgloc", f"bearer.{word}"]) as ws:  # fmt: skip
            assert ws.subprotocol == "imgloc"
        problem(httpx.get(f"{at}/v1/maps", headers={**own, "Host": "evil.example"}), 403,
                "forbidden")  # fmt: skip


def test_a_bad_line_ends_a_robot_with_a_problem(service: Served) -> None:
    for line, said in (("{", "JSON"), ('{"angles": [0]}', "ranges: missing")):
        with connect(f"{service.track}?map=curved") as one:
            one.send(line)
            told = json.loads(one.recv(timeout=30))
            assert (told["status"], "line 1" in told["detail"]) == (422, True)
            assert said in told["detail"]
            with pytest.raises(Exception, match="1007"):
                one.recv(timeout=30)


def test_a_stamp_that_leaps_is_answered_and_is_not_the_end(service: Served) -> None:
    """The clock is the robot's: an hour ahead is none of its errors, a leap is until the second."""
    with connect(f"{service.track}?map=curved") as robot:
        begin, told = time.time() + 3600.0, []
        for stamp in (0.0, 0.1, -20.0, 0.2, 99.0, 0.3, -20.0, -19.9):
            robot.send(json.dumps({**STILL, "stamp": begin + stamp}))
            row = json.loads(robot.recv(60))
            told.append(row.get("why", ""))
        assert told == ["", "", "old", "", "ahead", "", "old", ""]


# Load, and the end.


def asked(
    path: str, scans: Path, count: int
) -> tuple[list[httpx.Response], list[threading.Thread]]:
    """Ask so many times at once: the answers, as they come, and the threads that wait for them."""
    found: list[httpx.Response] = []
    data = scans.read_bytes()
    ask = lambda: found.append(httpx.post(path, content=data, timeout=60))  # noqa: E731
    threads = [threading.Thread(target=ask) for _ in range(count)]
    for thread in threads:
        thread.start()
    return found, threads


def test_what_is_too_much_is_told_to_come_back_and_the_rest_is_answered(scans: Path) -> None:
    with served(MAP, "--waiting", 2) as one:
        found, threads = asked(f"{one.address}/v1/localize?method=ght-v", scans, 8)
        for thread in threads:
            thread.join(60)
        codes = sorted(answer.status_code for answer in found)
        assert set(codes) == {200, 503}
        busy = next(answer for answer in found if answer.status_code == 503)
        assert int(busy.headers["retry-after"]) >= 1
        problem(busy, 503, "busy")
        text = one.metrics()
        assert f'imgloc_requests_total{{status="503"}} {codes.count(503)}.0' in text
        assert 'imgloc_refused_total{problem="busy"}' in text
        assert 'imgloc_answers_total{kind="localize"' in text
        assert one.end()[0] == 0


def test_an_answer_that_takes_too_long_is_given_up(scans: Path) -> None:
    with served(MAP, "--seconds", 0.1) as one:
        path = f"{one.address}/v1/localize?method=ght-v&theta_step_deg=0.5"
        answer = httpx.post(path, content=scans.read_bytes(), timeout=60)
        problem(answer, 504, "out-of-time")
        assert httpx.get(f"{one.address}/healthz").status_code == 200


def test_sigterm_ends_what_runs_and_refuses_the_rest(scans: Path) -> None:
    with served(MAP) as one:
        found, threads = asked(f"{one.address}/v1/localize?method=ght-v&index=0", scans, 5)
        waits(lambda: found or 'imgloc_queue{lane="answers"} 5.0' in one.metrics())
        code, err = one.end()
        for thread in threads:
            thread.join(60)
    assert (code, err) == (0, "")
    codes = [answer.status_code for answer in found]
    assert len(codes) == 5
    assert set(codes) <= {200, 503}
    assert 200 in codes


def test_ctrl_c_ends_it_too_and_tells_those_who_are_followed() -> None:
    with served(MAP) as one, connect(one.track) as robot:
        assert one.end(signal.SIGINT)[0] == 130
        with pytest.raises(ConnectionClosed, match="1012"):
            robot.recv(timeout=30)


# The command.


def test_a_service_that_is_killed_loses_nothing_but_what_ran(scans: Path, tmp_path: Path) -> None:
    """kill -9 with a request, an upload and a robot under way; then it is started again."""
    cache = tmp_path / "cache"
    image = (MAPS / "curved.png").read_bytes()
    head = b"POST /v1/maps?name=half&resolution=0.05 HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n"
    asked = {"params": {"map": "visibility"}, "content": scans.read_bytes(), "timeout": 60}
    with served(MAP, "--cache", cache) as one:
        id_ = upload(one.address, "mine", "curved").json()["id"]
        answer = httpx.post(f"{one.address}/v1/localize", **asked).text
        failed = list[str]()

        def ask() -> None:
            try:
                many = f"{one.address}/v1/localize"
                hard = {**asked["params"], "method": "beam", "theta_step_deg": 1}
                httpx.post(many, **{**asked, "params": hard})
            except httpx.HTTPError as error:
                failed.append(type(error).__name__)

        request = threading.Thread(target=ask)
        with (
            connect(f"{one.track}?map={id_}") as robot,
            socket.create_connection(("127.0.0.1", one.port)) as sending,
        ):
            robot.send(LINE)
            assert json.loads(robot.recv(60))["index"] == 0
            more = b"Content-Type: image/png\r\nContent-Length: %d\r\n\r\n" % len(image)
            sending.sendall(head % one.port + more + image[: len(image) // 2])
            request.start()
            waits(lambda: 'imgloc_queue{lane="answers"} 1.0' in one.metrics())
            assert one.end(signal.SIGKILL)[0] == -signal.SIGKILL
            with pytest.raises(ConnectionClosed):
                robot.recv(60)
            request.join(60)
        assert failed  # whoever waits is not told an answer
    kept = sorted(path for path in cache.rglob("*") if path.is_file())
    assert kept
    assert not [path.name for path in kept if not path.name.endswith(".npz")]
    with served(MAP, "--cache", cache) as one:
        names = [one["name"] for one in httpx.get(f"{one.address}/v1/maps").json()["maps"]]
        assert names == ["visibility"]
        problem(httpx.get(f"{one.address}/v1/maps/{id_}"), 404, "not-found")
        assert untimed(httpx.post(f"{one.address}/v1/localize", **asked).text) == untimed(answer)
        assert upload(one.address, "mine", "curved").status_code == 201
        assert one.end()[0] == 0


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgloc.cli.serve._NEEDED", ("starlette", "not_to_be_had"))
    run = call("serve", MAP)
    assert run.code == 2
    assert "needs not-to-be-had; pip install 'imgloc[serve]'" in run.err


def test_a_bad_map_is_left_out_unless_there_is_no_other(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("image: none.png\n")
    run = call("serve", tmp_path / "bad.yaml", "--port", 0)
    assert run.code == 3
    assert "none.png" in run.err
    with served(MAP, tmp_path / "bad.yaml") as one:
        names = [m["name"] for m in httpx.get(f"{one.address}/v1/maps").json()["maps"]]
        assert names == ["visibility"]
        code, err = one.end()
        assert code == 0
        assert err.startswith("imgloc: left out: ")


def test_no_answer_waits_for_the_client_to_acknowledge_its_head() -> None:
    with bound("127.0.0.1", 0) as one:
        one.listen()

        async def accepted() -> int:
            here: asyncio.Future[int] = asyncio.get_running_loop().create_future()

            def connected(_: Any, writer: asyncio.StreamWriter) -> None:
                made = writer.get_extra_info("socket")
                here.set_result(made.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
                writer.close()

            async with await asyncio.start_server(connected, sock=one):
                with socket.create_connection(one.getsockname()):
                    return await here

        assert asyncio.run(accepted())


def test_a_port_that_is_taken_is_said(service: Served) -> None:
    run = call("serve", MAP, "--port", service.port)
    assert run.code == 2
    assert f"127.0.0.1:{service.port}" in run.err


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_examples_with_curl_are_answered(impatient, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parents[2] / "tools/docs/serving.md").read_text()
    lines = [
        shlex.split(line, comments=True) for line in re.findall(r"(?m)^(?:curl|imgloc) .*", text)
    ]
    simulate = next(words for words in lines if words[1] == "simulate")
    assert call(*simulate[1:]).code == 0
    asked = [words for words in lines if words[0] == "curl"]
    assert asked
    for words in asked:
        here = [word.replace("http://127.0.0.1:8080", impatient.address) for word in words]
        run = subprocess.run([*here, "-s"], capture_output=True, text=True, timeout=60, check=True)
        assert json.loads(run.stdout)["verdict"] == "unique"


@pytest.mark.parametrize(
    ("key", "value"),
    [("angle_min", "x"), ("angle_increment", 13.6), ("angle_max", {}), ("range_max", "5")],
)
def test_what_a_scan_does_not_need_has_to_be_right_too(http, scans, key, value):
    body = {"angle_min": None, "mount": None, **laser_scan(scans, 0)}
    assert http.post("/v1/localize?map=visibility", json=body).status_code == 200
    answer = http.post("/v1/localize?map=visibility", json={**body, key: value})
    assert f"body: {key}: got {value!r}" in problem(answer, 422, "bad-scan")


def test_schemathesis_finds_nothing(service: Served, tmp_path: Path) -> None:
    """What fits the document may still contradict itself: 422, and nothing else, says so."""
    (tmp_path / "schemathesis.toml").write_text(
        "[checks.positive_data_acceptance]\n"
        'expected-statuses = ["200", "201", "204", "403", "404", "409", "413", "422"]\n'
    )
    program = "from schemathesis.cli import schemathesis; schemathesis()"
    run = subprocess.run(
        [sys.executable, "-c", program, "--config-file", "schemathesis.toml", "run",
         f"{service.address}/v1/openapi.json", "--max-examples", "1", "--seed", "1",
         "--phases", "fuzzing", "--no-color", "--warnings", "off"],
        cwd=tmp_path, capture_output=True, text=True, timeout=500, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stdout[-4000:] + run.stderr[-2000:]
    assert "No issues found" in run.stdout
