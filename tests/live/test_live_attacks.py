"""What some clients do to a service, with or without intent, and the others must not notice."""

import asyncio
import contextlib
import io
import json
import os
import random
import re
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from command import MAPS, command
from serving import Served, memory, served, waits
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import imgloc
from imgloc import LaserScan, Localizer, Pose2D
from imgloc.io.textscans import read_jsonl_line
from imgloc.live.bounds import Bounds
from imgloc.live.connections import has_gone
from imgloc.live.service import Service
from imgloc.output.rows import scan_row

CURVED = MAPS / "curved.yaml"
SCAN = {"ranges": [2.0] * 90, "angle_min": -1.5, "angle_increment": 0.03}
LINE = json.dumps({**SCAN, "odom": [0, 0, 0]})


def room(width: int, height: int, mark: int = 0) -> bytes:
    """The image of a room with something in it."""
    cells = np.full((height, width), 254, np.uint8)
    cells[:2] = cells[-2:] = 0
    cells[:, :2] = cells[:, -2:] = 0
    cells[height // 3 : height // 3 + 6 + mark, width // 4 : width // 4 + 10 + mark] = 0
    return bytes(cv2.imencode(".png", cells)[1])


def sent_map(one: Served, image: bytes, **more: Any) -> str:
    """The id of a map that is sent."""
    how = {"name": "big", "resolution": 0.05, **more}
    answer = httpx.post(f"{one.address}/v1/maps", params=how, content=image, timeout=60)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def sent_scans(one: Served, body: bytes, name: str = "a.jsonl") -> str:
    """The id of scans that are sent."""
    answer = httpx.post(f"{one.address}/v1/scans?name={name}", content=body, timeout=60)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def healthy(one: Served) -> bool:
    return httpx.get(f"{one.address}/healthz", timeout=30).status_code == 200


def meanwhile(one: Served, ask: Callable[[], httpx.Response]) -> tuple[int, httpx.Response]:
    """How often it is said that the service runs before a request is answered; its answer."""
    found, count = list[httpx.Response](), 0
    thread = threading.Thread(target=lambda: found.append(ask()))
    thread.start()
    with httpx.Client(base_url=one.address, timeout=30) as http:
        while thread.is_alive():
            assert http.get("/healthz").status_code == 200
            count += not found
    thread.join()
    return count, found[0]


@pytest.fixture(scope="module")
def service() -> Iterator[Served]:
    with served(CURVED) as one:
        yield one


# Nothing is computed on the loop.


@pytest.mark.parametrize("query", ["region", "clearance"])
def test_others_are_answered_while_a_prior_is_made(service: Served, query: str) -> None:
    id_ = sent_map(service, room(2000, 2000))
    turns = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    corners = 50 + 45 * np.column_stack((np.cos(turns), np.sin(turns)))
    prior = {"region": ",".join(f"{v:.2f}" for v in corners.ravel()), "clearance": "0.3"}[query]
    asked = {"map": id_, query: prior}
    url = f"{service.address}/v1/localize"
    count, answer = meanwhile(service, lambda: httpx.post(url, params=asked, json=SCAN, timeout=60))
    assert answer.status_code == 200, answer.text
    assert answer.json()["map"] == id_
    assert count >= 10  # of a search that takes a second
    assert httpx.delete(f"{service.address}/v1/maps/{id_}").status_code == 204


def test_a_long_list_of_indices_is_refused_before_it_is_made(service: Served) -> None:
    npz = io.BytesIO()
    np.savez_compressed(npz, ranges=np.full((20_000, 1), 1.0), angles=np.zeros(1))
    id_ = sent_scans(service, npz.getvalue(), "a.npz")
    asked = {"map": "curved", "scans": id_, "index": ",".join(["0:"] * 100)}
    answer = httpx.post(f"{service.address}/v1/localize", params=asked, timeout=60)
    assert answer.status_code == 413
    assert "at most 1,000 at once; index names some" in answer.json()["detail"]


def test_json_of_millions_of_numbers_is_refused_before_it_holds_all_threads(service):
    body = b'{"angle_min": 0, "angle_increment": 0.001, "ranges": [' + b"1," * 500_000 + b"1]}"
    kind = {"Content-Type": "application/json"}
    answer = httpx.post(f"{service.address}/v1/localize", content=body, headers=kind, timeout=60)
    assert answer.status_code == 413
    assert "500,002 values, expected at most 400,000" in answer.json()["detail"]


def test_marks_are_no_more_than_there_are_scans(service: Served) -> None:
    id_ = sent_scans(service, json.dumps(SCAN).encode())
    url = f"{service.address}/v1/scans/{id_}/marked"
    assert httpx.post(url, json={"poses": [[0, 1, 2, 3]]}).status_code == 200
    answer = httpx.post(url, content=b'{"poses": [' + b"[0,1,2,3]," * 10_000 + b"[0,1,2,3]]}")
    assert answer.status_code == 413


def test_scans_weigh_more_than_their_readings() -> None:
    npz = io.BytesIO()
    np.savez_compressed(npz, ranges=np.full((8, 1), 1.0), angles=np.zeros(1))

    async def statuses(service: Service) -> list[int]:
        transport = httpx.ASGITransport(service)
        async with httpx.AsyncClient(base_url="http://127.0.0.1", transport=transport) as ask:
            url, ids = "/v1/scans?name=a.npz", list[str]()
            for _ in range(3):
                ids.append((await ask.post(url, content=npz.getvalue())).json()["id"])
            return [(await ask.get(f"/v1/scans/{id_}?count=1")).status_code for id_ in ids]

    with contextlib.closing(Localizer({"curved": imgloc.load_map(CURVED)})) as core:
        found = asyncio.run(statuses(Service(core, bounds=Bounds(numbers=1000))))
    assert found == [404, 200, 200]  # 816 numbers each, 16 of which are readings; 2,000 together


# Memory.


def test_all_bodies_have_one_budget() -> None:
    size = 16 << 20
    with served(CURVED, "--memory-budget", "128M", "--max-body", "16M") as one:
        head = f"POST /v1/scans?name=a.csv HTTP/1.1\r\nHost: 127.0.0.1:{one.port}\r\n"
        before, sockets = memory(one), list[socket.socket]()
        with contextlib.ExitStack() as stack:
            for _ in range(8):
                there = stack.enter_context(socket.create_connection(("127.0.0.1", one.port)))
                with contextlib.suppress(OSError):  # those that are refused
                    there.sendall(f"{head}Content-Length: {size}\r\n\r\n".encode())
                    there.sendall(b"1" * (size - 1))
                sockets.append(there)
            assert healthy(one)
            assert memory(one) - before < 32 + 2 * 16 + 16
            there = sockets[-1]
            there.settimeout(30)
            assert there.recv(100).startswith(b"HTTP/1.1 503 ")
        waits(lambda: httpx.post(f"{one.address}/v1/scans", json=SCAN).status_code == 201)


def test_the_poses_of_an_atlas_are_counted_before_they_are_made() -> None:
    with served(CURVED, "--memory-budget", "512M") as one:
        map_, scans = sent_map(one, room(800, 800)), sent_scans(one, json.dumps(SCAN).encode())
        before = memory(one, "VmHWM")
        asked = {"map": map_, "scans": scans, "step": 0.05, "headings": 72}
        answer = httpx.get(f"{one.address}/v1/layers/atlas", params=asked, timeout=60)
        assert answer.status_code == 422
        assert "use a larger step" in answer.json()["detail"]
        assert memory(one, "VmHWM") - before < 50


# Connections.


def test_who_asks_and_never_reads_is_closed_and_shuts_nobody_out() -> None:
    with served(CURVED, "--patience", 1) as one, contextlib.ExitStack() as stack:
        ask = f"GET /page.css HTTP/1.1\r\nHost: 127.0.0.1:{one.port}\r\n\r\n" * 700
        mute = list[socket.socket]()
        for _ in range(100):
            there = stack.enter_context(socket.socket())
            there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            there.connect(("127.0.0.1", one.port))
            there.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                there.send(ask.encode())
            mute.append(there)
        assert healthy(one)
        waits(lambda: descriptors(one) <= 60)


def descriptors(one: Served) -> int:
    folder = Path(f"/proc/{one.process.pid}/fd")
    if not folder.exists():
        pytest.skip("needs Linux: a process that knows its files")
    return len(list(folder.iterdir()))


def test_half_a_body_makes_room(service: Served) -> None:
    head = f"POST /v1/localize HTTP/1.1\r\nHost: 127.0.0.1:{service.port}\r\n"
    with contextlib.ExitStack() as stack:
        for _ in range(100):
            there = stack.enter_context(socket.create_connection(("127.0.0.1", service.port)))
            there.sendall(f"{head}Content-Length: 1000\r\n\r\n{{".encode())
        for _ in range(5):
            assert healthy(service)
        assert httpx.post(f"{service.address}/v1/localize", json=SCAN, timeout=60).is_success


def test_a_burst_stays_within_the_bound(service: Served) -> None:
    before = descriptors(service)
    with contextlib.ExitStack() as stack:
        for _ in range(500):
            there = stack.enter_context(socket.socket())
            there.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                there.connect(("127.0.0.1", service.port))
        for _ in range(5):
            assert healthy(service)
            assert descriptors(service) <= before + Bounds().connections + 10


def test_who_has_gone_without_a_word_is_told_from_who_waits() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accepted(act: Callable[[socket.socket], object]) -> bool:
            with socket.create_connection(server.getsockname()) as there:
                client, _ = server.accept()
                client.setblocking(False)
                act(there)
                time.sleep(0.05)
                with client:
                    return has_gone(client)

        assert not accepted(lambda there: None)
        assert not accepted(lambda there: there.send(b"G"))
        assert not accepted(lambda there: (there.send(b"G"), there.shutdown(socket.SHUT_WR)))
        assert accepted(lambda there: there.shutdown(socket.SHUT_WR))
        reset = struct.pack("ii", 1, 0)  # an end without a word is then a reset
        linger = socket.SOL_SOCKET, socket.SO_LINGER, reset
        assert accepted(lambda there: (there.setsockopt(*linger), there.close()))


def test_a_burst_beyond_all_descriptors_says_nothing_and_ends() -> None:
    with subprocess.Popen(
        ["bash", "-c", 'ulimit -n 64; exec "$@"', "bash", *command(["serve", "--port", 0, CURVED])],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        one = Served(process.stdout.readline().strip(), process)
        with contextlib.ExitStack() as stack:
            for _ in range(200):
                there = stack.enter_context(socket.socket())
                there.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    there.connect(("127.0.0.1", one.port))
            time.sleep(1)
            code, err = one.end()
    assert (code, err) == (0, "")


def test_a_silent_robot_makes_room_and_is_told() -> None:
    with served(CURVED, "--patience", 0.5) as one, contextlib.ExitStack() as stack:
        url = one.track
        silent = [stack.enter_context(connect(url)) for _ in range(16)]
        time.sleep(1)
        silent[0].send(LINE)
        assert json.loads(silent[0].recv(60))["index"] == 0
        with connect(url) as robot:
            robot.send(LINE)
            assert json.loads(robot.recv(60))["index"] == 0
            told = json.loads(silent[1].recv(60))  # the one that was silent for longest
            assert (told["status"], "no line for" in told["detail"]) == (408, True)
            with pytest.raises(ConnectionClosed):
                silent[1].recv(60)
        silent[0].send(LINE)
        assert json.loads(silent[0].recv(60))["index"] == 1


def test_robots_that_speak_make_no_room(service: Served) -> None:
    url = service.track
    with contextlib.ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(connect(url))
        with pytest.raises(Exception, match="503"):
            connect(url)


def test_a_robot_that_does_not_read_is_followed_no_more() -> None:
    with served(CURVED, "--patience", 0.5) as one, socket.socket() as mute:
        mute.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        mute.connect(("127.0.0.1", one.port))
        mute.sendall(
            f"GET /v1/track?places=true HTTP/1.1\r\nHost: 127.0.0.1:{one.port}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        mute.settimeout(60)
        assert mute.recv(20).startswith(b"HTTP/1.1 101 ")
        mute.setblocking(False)
        line = LINE.encode()
        frame = b"\x81\xfe" + len(line).to_bytes(2, "big") + bytes(4) + line  # masked by zeros
        until, rest = time.monotonic() + 60, b""
        while "imgloc_sockets 1.0" in one.metrics():
            assert time.monotonic() < until
            rest = rest or 20 * frame
            with contextlib.suppress(OSError):
                rest = rest[mute.send(rest) :]
        assert re.search(r'refused.*"too-slow"} 1.0', one.metrics())


def test_sigterm_ends_it_in_each_state_also_when_nobody_reads_what_it_says() -> None:
    """Clients are silent, or in each part of a request; standard error is a pipe that is full."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(write, b"x" * 4096)
    os.set_blocking(write, True)
    process = subprocess.Popen(
        command(["serve", "--port", "0", CURVED]), stdout=subprocess.PIPE, stderr=write, text=True
    )
    try:
        one = Served(process.stdout.readline().strip(), process)
        host = f"Host: 127.0.0.1:{one.port}\r\n"
        beam = f"scans={sent_scans(one, json.dumps(SCAN).encode())}&method=beam"
        states = (
            "",
            "GET / HTTP/1.1\r\nHost",
            f"GET /healthz HTTP/1.1\r\n{host}\r\n",
            f"POST /v1/which HTTP/1.1\r\n{host}Content-Length: 9\r\n\r\n{{",
            f"GET /page.css HTTP/1.1\r\n{host}\r\n" * 2000,  # whose answers nobody reads
            f"GET /v1/layers/likelihood?{beam} HTTP/1.1\r\n{host}\r\n",
        )
        with contextlib.ExitStack() as stack:
            for said in states:
                there = stack.enter_context(socket.create_connection(("127.0.0.1", one.port)))
                there.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    there.send(said.encode())
            stack.enter_context(connect(one.track))
            time.sleep(0.3)
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
    finally:
        process.kill()
        process.communicate()
        os.close(read)
        os.close(write)


# What one sends is one's own.


def test_two_clients_with_one_name_never_see_each_others_map(service: Served) -> None:
    """160 steps in random order: each is answered from the map that the client has sent."""
    draw, maps = random.Random(5), [room(60, 50), room(50, 60, 9)]
    scan = {"ranges": [1.0] * 12, "angle_min": -3.0, "angle_increment": 0.5}
    how = {"name": "office", "resolution": "0.1"}

    async def client(ask: httpx.AsyncClient, image: bytes, steps: int) -> None:
        about: dict[str, Any] | None = None
        version = ""
        for _ in range(steps):
            await asyncio.sleep(draw.random() / 1000)
            if about is None:
                sent = await ask.post("/v1/maps", params=how, content=image)
                assert sent.status_code == 201, sent.text
                about = sent.json()
                assert version in ("", about["version"])
                version = about["version"]
            elif draw.random() < 0.1:
                gone = await ask.delete(f"/v1/maps/{about['id']}")
                assert gone.status_code == 204
                about = None
            else:
                url = f"/v1/localize?map={about['id']}&method=ght&theta_step_deg=30"
                row = (await ask.post(url, json=scan)).json()
                assert (row["map"], row["version"]) == (about["id"], version)

    async def run(address: str) -> None:
        async with httpx.AsyncClient(base_url=address, timeout=120) as ask:
            await asyncio.gather(*(client(ask, image, 80) for image in maps))

    asyncio.run(run(service.address))


def test_a_map_that_goes_meanwhile_still_answers_who_has_asked(service: Served) -> None:
    """The body comes after the map was deleted: the map is looked for once."""
    how = {"name": "office", "resolution": "0.1"}
    sent = httpx.post(f"{service.address}/v1/maps", params=how, content=room(60, 50), timeout=60)
    about, body = sent.json(), json.dumps(SCAN).encode()
    for query in ("", "&near=3,3,0,3"):
        head = (
            f"POST /v1/localize?map={about['id']}{query} HTTP/1.1\r\nHost: 127.0.0.1:{service.port}"
            "\r\nContent-Type: application/json\r\nExpect: 100-continue\r\nConnection: close\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        with socket.create_connection(("127.0.0.1", service.port), timeout=60) as there:
            there.sendall(head.encode())
            assert there.recv(100).startswith(b"HTTP/1.1 100 ")  # the map is found by now
            assert httpx.delete(f"{service.address}/v1/maps/{about['id']}").status_code == 204
            other = sent_map(service, room(50, 60, 9), **how)
            there.sendall(body)
            answer = b"".join(iter(lambda: there.recv(65536), b""))
        assert answer.startswith(b"HTTP/1.1 200 ")
        row = json.loads(answer.partition(b"\r\n\r\n")[2])
        assert (row["map"], row["version"]) == (about["id"], about["version"])
        about = httpx.get(f"{service.address}/v1/maps/{other}").json()


def test_uploads_of_one_client_do_not_push_out_those_of_another(service: Served) -> None:
    """They come from two addresses."""
    mine = sent_map(service, room(60, 50))
    scans = sent_scans(service, json.dumps(SCAN).encode())
    elsewhere = httpx.HTTPTransport(local_address="127.0.0.2")
    with httpx.Client(base_url=service.address, transport=elsewhere, timeout=60) as other:
        for _ in range(2 * Bounds().held):
            how = {"name": "big", "resolution": 0.05}
            assert other.post("/v1/maps", params=how, content=room(40, 50)).is_success
            assert other.post("/v1/scans?name=a.jsonl", json=SCAN).is_success
    assert httpx.get(f"{service.address}/v1/maps/{mine}").status_code == 200
    assert httpx.get(f"{service.address}/v1/scans/{scans}").status_code == 200


def test_a_layer_that_nobody_waits_for_makes_room_for_the_next(service: Served) -> None:
    """Each of these takes minutes."""
    map_ = sent_map(service, room(1500, 1500))
    scans = sent_scans(
        service, json.dumps({**SCAN, "ranges": [2.0 + k / 90 for k in range(90)]}).encode()
    )
    layer = f"GET /v1/layers/likelihood?map={map_}&scans={scans}&method=beam HTTP/1.1\r\n"
    for _ in range(3):
        with socket.create_connection(("127.0.0.1", service.port)) as there:
            there.sendall(f"{layer}Host: 127.0.0.1:{service.port}\r\n\r\n".encode())
            waits(lambda: layers(service))
        waits(lambda: not layers(service))
    httpx.delete(f"{service.address}/v1/maps/{map_}")


def layers(one: Served) -> int:
    """How many layers are under way."""
    return int(float(re.findall(r'queue.*"layers".* (\S+)', one.metrics())[0]))


# A scan is read back as it was sent.


def test_the_row_of_a_scan_keeps_every_field() -> None:
    scan = LaserScan(
        [1.0, np.inf, np.nan, -np.inf], [-0.5, 0.0, 0.25, 0.5], range_min=0.1, range_max=9.0,
        stamp=12.5, T_base_laser=Pose2D(0.1, -0.2, 3.0), time_increment=0.001,
    )  # fmt: skip
    row = scan_row(imgloc.ScanSet((scan,)), 0)
    again = read_jsonl_line(json.dumps(row, allow_nan=False), "row")[0]
    for name in vars(scan):
        np.testing.assert_equal(getattr(again, name), getattr(scan, name), name)
