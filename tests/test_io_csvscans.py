"""Tables that others write: columns are understood by their names and by what they hold."""

import logging
import math
import re
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

from imgloc import ScanError, ScanSet, load_scans

N, RAYS = 6, 36
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, RAYS)
RANGES = np.random.default_rng(3).uniform(1, 9, (N, RAYS)).round(3)
STEP = ANGLES[1] - ANGLES[0]
STAMPS = 1.7e9 + 0.1 * np.arange(N)
SAID, VIEW = f"# angle_min={ANGLES[0]}, angle_max={ANGLES[-1]}\n", "# angle_min=-1, angle_max=1\n"
FIELDS = {
    "angle_min": ANGLES[0], "angle_max": ANGLES[-1], "angle_increment": STEP,
    "time_increment": 0.0, "scan_time": 0.1, "range_min": 0.05, "range_max": 12.0,
}  # fmt: skip


BETWEEN = {"blanks": "  ", "tabs": "\t", "bars": "|", "ends of lines of a Macintosh": ","}


def table(head: list[str], rows: list[list[object]], mark: str = ",") -> str:
    lines = [head] * bool(head) + rows
    return "".join(mark.join(str(cell) for cell in line) + "\n" for line in lines)


def exported(kind: str) -> str:
    """The scans as a table of somebody's."""
    if "print" in kind:
        return printed(kind)
    fields, n = list(FIELDS.items()), range(RAYS)
    ns = [round(1e9 * t) for t in STAMPS]
    values = [value for _, value in fields]
    if kind == "rostopic -p":
        names = ["seq", "stamp", "frame_id", *FIELDS, *(f"ranges{k}" for k in n)]
        names += [f"intensities{k}" for k in n]
        rows = [[t, k, t, "laser", *values, *RANGES[k], *[47] * RAYS] for k, t in enumerate(ns)]
        return table(
            ["%time", *(f"field.{'header.' * (k < 3)}{w}" for k, w in enumerate(names))], rows
        )
    if kind == "rostopic -p of simulated time":
        return exported("rostopic -p").replace("1700000000", "0000002000").replace("\n0", "\n")
    if kind == "ros2 --csv":
        return table([], [[t // 10**9, t % 10**9, "base_scan", *values, *RANGES[k]]
                          for k, t in enumerate(ns)])  # fmt: skip
    if kind == "ros2 --csv with intensities":
        return table([], [[t // 10**9, t % 10**9, "base_scan", *values, *RANGES[k], *[0.0] * RAYS]
                          for k, t in enumerate(ns)])  # fmt: skip
    if kind == "ros2 --csv without a frame":
        return exported("ros2 --csv").replace("base_scan", "")
    if kind == "bagpy":
        head = ["Time", "header.seq", "header.stamp.secs", "header.stamp.nsecs", "header.frame_id",
                *FIELDS, *(f"ranges_{k}" for k in n), *(f"intensities_{k}" for k in n)]  # fmt: skip
        stamps = [[STAMPS[k] + 0.03, k, t // 10**9, t % 10**9, "laser"] for k, t in enumerate(ns)]
        return table(head, [[*row, *values, *RANGES[k], *n] for k, row in enumerate(stamps)])
    if kind == "plotjuggler":
        names = [*FIELDS, "header/stamp", *(f"ranges[{k}]" for k in n)]
        pose = [f"/odom/pose/pose/{w}" for w in ("position/x", "position/y", "orientation/z",
                                                 "orientation/w")]  # fmt: skip
        head = ["__time", *pose, *(f"/scan/{w}" for w in names)]
        rows = [[t, *[""] * 4, *values, t, *RANGES[k]] for k, t in enumerate(STAMPS)]
        other = [[t + 0.01, 5.5, 2.5, 0.6, 0.8, *[""] * len(names)] for t in STAMPS]
        return table(head, [row for pair in zip(rows, other, strict=True) for row in pair])
    if kind == "foxglove":
        head = ["timestamp.sec", "timestamp.nsec", "frame_id", "start_angle", "end_angle"]
        stamps = [[t // 10**9, t % 10**9, "laser", ANGLES[0], ANGLES[-1]] for t in ns]
        return table(
            [*head, *(f"ranges[{k}]" for k in n)], [[*stamps[k], *RANGES[k]] for k in range(N)]
        )
    if kind == "dates":
        dates = [datetime.fromtimestamp(t, timezone.utc).isoformat() for t in STAMPS]
        return SAID + table([], [[dates[k], *RANGES[k]] for k in range(N)])
    if kind == "pandas":
        head = ["", "timestamp_ms", *(f"range_{k}" for k in n)]
        return SAID + table(head, [[k, 1000 * t, *RANGES[k]] for k, t in enumerate(STAMPS)])
    if kind.startswith("lists in cells"):
        form = {"tuples": "({})", "arrays": "array('f', [{}])"}.get(kind.split()[-1], "[{}]")
        name = "/scan/ranges" if "NumPy" in kind else "ranges"
        mark = " " if "NumPy" in kind else ", "
        cells = [f'"{form.format(mark.join(map(str, scan)))}"' for scan in RANGES]
        rows = [[k, STAMPS[k], *values, cells[k], '"()"'] for k in range(N)]
        return table(["", "timestamp", *FIELDS, name, "intensities"], rows)
    if kind.startswith("angles first"):
        above = 0 if "number" in kind else ""
        first = ["time", *np.rad2deg(ANGLES).round(4)] if "degrees" in kind else [above, *ANGLES]
        return table(first, [[t, *RANGES[k]] for k, t in enumerate(STAMPS)])
    if kind == "rounded angles first":
        fine = np.linspace(-np.pi / 2, np.pi / 2, 361).round(2)
        return table(["", *fine], [[t, *np.resize(RANGES[k], 361)] for k, t in enumerate(STAMPS)])
    if kind == "names that say nothing":
        head = [f"Var{k + 1}" for k in range(RAYS + 1)]
        return SAID + table(head, [[0.1 * k, *RANGES[k]] for k in range(N)])
    if kind == "angles down":
        return table([], [[a, *RANGES[:, k]] for k, a in enumerate(ANGLES)])
    if kind == "angles down by name":
        return table(["angle_deg", *(f"scan{k}" for k in range(N))],
                     [[math.degrees(a), *RANGES[:, k]] for k, a in enumerate(ANGLES)])  # fmt: skip
    if kind in ("a reading a line", "a reading a line by semicolons"):
        head, mark = ["timestamp", "angle_deg", "distance_mm", "quality"], ","
        rows = [[t, math.degrees(a), 1000 * r, 47] for t, scan in zip(STAMPS, RANGES, strict=True)
                for a, r in zip(ANGLES, scan, strict=True)]  # fmt: skip
        if "semicolons" in kind:
            head, mark = ["Scan", "Winkel_Grad", "Distance [cm]"], ";"
            rows = [[k, f"{math.degrees(a):.6f}", f"{100 * r:.1f}"] for k, scan in enumerate(RANGES)
                    for a, r in zip(ANGLES, scan, strict=True)]  # fmt: skip
            return table(head, rows, mark).replace(".", ",")
        return table(head, rows, mark)
    if kind == "a reading a line without names":
        return table(
            [], [[a, r] for scan in RANGES for a, r in zip(ANGLES, scan, strict=True)], "\t"
        )
    if kind in BETWEEN:
        text = SAID + table([], RANGES.tolist(), BETWEEN[kind])
        return text.replace("\n", "\r") if "ends" in kind else text
    if kind in ("time first", "time last"):
        rows = np.column_stack((STAMPS, RANGES) if kind == "time first" else (RANGES, STAMPS))
        return SAID + table([], rows.tolist())
    assert kind == "savetxt"
    head = f"# t {' '.join(f'r{k}' for k in n)}\n# angle_min={ANGLES[0]}, angle_max={ANGLES[-1]}\n"
    return head + table([], [[t, *RANGES[k]] for k, t in enumerate(STAMPS)], " ")


def printed(kind: str) -> str:
    """The scans as a program prints them, long rows in pieces of seven."""
    rows = [[f"{v:.3f}" for v in row] for row in RANGES]
    pieces = [(k, slice(k, k + 7)) for k in range(0, RAYS, 7)]
    if "NumPy" in kind:
        return f"{SAID}{np.array2string(RANGES, threshold=RANGES.size)}\n"
    if "MATLAB" in kind:
        return f"{SAID}\nranges =\n\n" + "\n".join(
            f"  Columns {k + 1} through {k + 7}\n\n{table([], [row[at] for row in rows], '   ')}"
            for k, at in pieces
        )
    if "vector" in kind:
        return SAID + table([], [[f"[{k + 1}]", *row[at]] for row in rows for k, at in pieces], " ")
    names, rule = [f"r{k}" for k in range(RAYS)], f"|{'---|' * RAYS}"
    if "SQL" in kind:
        lines = [f"| {' | '.join(row)} |" for row in (names, *rows)]
        return SAID + "\n".join([lines[0], rule, *lines[1:], rule, f"({N} rows)"])
    return SAID + table(names, [[f'"{k}"', *row] for k, row in enumerate(rows)], " ")


KINDS = [
    "rostopic -p", "rostopic -p of simulated time", "ros2 --csv", "ros2 --csv with intensities",
    "ros2 --csv without a frame", "lists in cells", "lists in cells, as tuples",
    "lists in cells, as arrays", "lists in cells, of NumPy", "bagpy", "plotjuggler", "pandas",
    "foxglove", "dates", "bars", "ends of lines of a Macintosh",
    "angles first, time first", "angles first in degrees", "time last",
    "angles first, a number above the time",
    "angles down", "angles down by name", "a reading a line", "a reading a line by semicolons",
    "a reading a line without names", "blanks", "tabs", "time first", "savetxt",
    "print of NumPy", "print of MATLAB", "print of a vector", "print of SQL",
    "print into a file",
]  # fmt: skip


def loaded(folder: Path, text: str, topic: str | None = None) -> ScanSet:
    path = folder / "a.csv"
    path.write_text(text)
    return load_scans(path, topic=topic)


@pytest.mark.parametrize("kind", KINDS)
def test_a_table_of_somebody_is_read(tmp_path: Path, kind: str) -> None:
    scans = loaded(tmp_path, exported(kind))
    assert len(scans) == N
    np.testing.assert_allclose([scan.ranges for scan in scans.scans], RANGES, atol=1e-3)
    np.testing.assert_allclose([scan.angles for scan in scans.scans], [ANGLES] * N, atol=1e-5)
    if kind == "plotjuggler":
        np.testing.assert_allclose(scans.odom[1], (5.5, 2.5, 2 * math.asin(0.6)))
    if re.search("down|semicolons|names|print", kind) or kind in BETWEEN:
        assert scans.stamps is None
    else:
        first = 2000.0 if "simulated" in kind else STAMPS[0]
        np.testing.assert_allclose(scans.stamps - first, STAMPS - STAMPS[0], atol=1e-3)


def test_a_line_that_numbers_the_columns_is_no_scan(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    plain = table(list(range(RAYS)), RANGES.tolist())
    index = table(["", *range(RAYS)], [[k, *RANGES[k]] for k in range(N)])
    for text in (VIEW + plain, VIEW + index):
        np.testing.assert_allclose([scan.ranges for scan in loaded(tmp_path, text).scans], RANGES)
    (tmp_path / "a.csv").write_text(index)
    np.testing.assert_allclose(load_scans(tmp_path / "a.csv", fov=np.pi)[0].angles, ANGLES)
    assert "numbers the columns" not in caplog.text
    with pytest.raises(ScanError, match="line 1: it numbers the columns; angles: expected a line"):
        loaded(tmp_path, plain)
    turn = table(["stamp", *range(360)], [[k, *np.resize(RANGES, 360)] for k in range(N)])
    scans = loaded(tmp_path, turn)
    assert (scans[0].angles[-1], scans.stamps[-1]) == (pytest.approx(math.radians(359)), N - 1)
    assert "if it numbers the columns, pass `fov`" in caplog.text


def test_marks_between_thousands_are_no_decimal_ones(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    mm = np.round(1000 * RANGES / 3)
    for between, mark in ((";", ","), (";", "."), ("\t", "'"), (",", ","), (";", "\u202f")):
        for some in (mm, mm[:1]):
            cells = [[f"{v:,.0f}".replace(",", mark) for v in row] for row in some]
            cells = [[f'"{c}"' for c in row] for row in cells] if between == mark else cells
            scans = loaded(tmp_path, VIEW + table([], cells, between))
            np.testing.assert_array_equal([scan.ranges for scan in scans.scans], some)
    assert "in thousands" in caplog.text
    rows = [
        [f"{v:,.0f}", f"{a:,.0f}"] for v, a in zip(1000 * RANGES[0], 50 * RANGES[1], strict=True)
    ]
    for turn in (1, -1):  # a column that is in millimetres decides for those before it, too
        cells = [[k, *row[::turn]] for k, row in enumerate(rows)]
        text = table(["angle_deg", *["distance_mm", "signal"][::turn]], cells, ";")
        np.testing.assert_allclose(loaded(tmp_path, text)[0].ranges, RANGES[0], atol=1e-3)
    cells = [[f"{v:.3f}".replace(".", ",") for v in row] for row in RANGES]
    assert loaded(tmp_path, VIEW + table([], cells, ";"))[0].ranges[0] == RANGES[0, 0]


@pytest.mark.parametrize("how", ["between", "after", "in threes"])
def test_intensities_without_a_name_are_refused(tmp_path: Path, how: str) -> None:
    near, many = np.linspace(1, 3, RAYS) + 0.01 * RANGES, np.resize(np.arange(40, 60), (N, RAYS))
    rows = {"after": np.hstack((near, many)), "between": np.stack((near, many + 0.5), 2),
            "in threes": np.stack((near, many, 10 * many), 2)}[how].reshape(N, -1)  # fmt: skip
    with pytest.raises(ScanError, match="other numbers, such as intensities, or marks"):
        loaded(tmp_path, VIEW + table([], rows.tolist()))
    names = [f"{word}{k}" for k in range(RAYS) for word in ("range", "intensity")]
    if how == "between":
        scans = loaded(tmp_path, VIEW + table(names, rows.tolist()))
        np.testing.assert_allclose(scans[0].ranges, near[0])


def test_a_count_is_no_range(tmp_path: Path) -> None:
    ranges = np.resize(RANGES, (N, 60))
    text = table([], [[60, ANGLES[0], STEP, *row] for row in ranges])
    with pytest.raises(ScanError, match="3 lines of one range each, expected a scan a line"):
        loaded(tmp_path, VIEW + "1.5\n1.6\n1.7\n")
    with pytest.raises(ScanError, match="column 1 is 60 in each line of 63 numbers"):
        loaded(tmp_path, VIEW + text)


def test_columns_of_two_names_are_not_all_ranges(tmp_path: Path) -> None:
    rows = [[v for r in row for v in (r, 47)] for row in RANGES]
    for words in (("r", "i"), ("d", "q"), ("dist_", "quality_")):
        text = VIEW + table([f"{word}{k}" for k in range(RAYS) for word in words], rows)
        if words[0] != "d":
            np.testing.assert_array_equal(loaded(tmp_path, text)[1].ranges, RANGES[1])
            continue
        with pytest.raises(ScanError, match="columns q0, q1, q2, q3, q4: besides ranges such as d"):
            loaded(tmp_path, text)


def test_a_column_beside_angles_and_ranges_is_no_second_scan(tmp_path: Path) -> None:
    degrees, noise = np.rad2deg(ANGLES).tolist(), np.random.default_rng(5).permutation(RAYS)
    for others in (50 + noise, 0.1 + noise / 7, RANGES[1] - 5):
        text = table([], [list(row) for row in zip(degrees, RANGES[0], others, strict=True)])
        with pytest.raises(ScanError, match=r"column 1 holds angles.*angle,range,intensity, or"):
            loaded(tmp_path, text)
    smooth = 3 + np.sin(3 * ANGLES)[:, None] + 0.2 * np.cos(ANGLES[:, None] * np.arange(1, 3))
    other = 3 + np.cos(3 * ANGLES + 1)  # of another place
    for scans in (smooth.T, [smooth[:, 0], other], [smooth[:, 0], other, 6 - other], RANGES):
        text = table([], np.round(np.column_stack((degrees, *scans)), 3).tolist())
        assert len(loaded(tmp_path, text)) == len(scans)


@pytest.mark.parametrize("kind", ["named", "bare"])
def test_empty_cells_between_tabs_are_rays(tmp_path: Path, kind: str) -> None:
    rows = [["", *RANGES[0, 1:]], [*RANGES[1, :-1], ""], [*RANGES[2]]]
    head = [f"r{k}" for k in range(RAYS)] if kind == "named" else []
    for scan, row in zip(loaded(tmp_path, VIEW + table(head, rows, "\t")).scans, rows, strict=True):
        assert len(scan.ranges) == RAYS
        assert np.count_nonzero(np.isnan(scan.ranges)) == row.count("")
    indented = table([], [[f"\t{row[0]}", *row[1:]] for row in RANGES.tolist()], "\t")
    np.testing.assert_array_equal(loaded(tmp_path, VIEW + indented)[1].ranges, RANGES[1])


def test_a_turn_of_400_is_in_gradians(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    turn = np.arange(0, 400, 400 / RAYS).tolist()
    down = [list(pair) for pair in zip(turn, RANGES[0], strict=True)]
    for text in (table(["t", *turn], [[0, *RANGES[0]]]), table(["angle", "range"], down)):
        scan = loaded(tmp_path, text)[0]
        np.testing.assert_allclose(scan.angles, np.deg2rad(np.arange(0, 360, 10)))
        assert "they are taken for gradians" in caplog.text
        caplog.clear()


def test_the_order_of_an_rplidar_is_named(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    rows = [[47, a, r] for a, r in zip(np.arange(0, 360, 10), RANGES[0], strict=True)]
    (scan,) = loaded(tmp_path, table([], rows)).scans
    np.testing.assert_allclose(scan.ranges, RANGES[0])
    assert "an RPLIDAR's, which counts them clockwise: `flipped=True`" in caplog.text
    caplog.clear()
    loaded(tmp_path, table(["quality", "angle", "distance_mm"], rows, ";"))
    assert "an RPLIDAR's, which counts them clockwise: `flipped=True`" in caplog.text
    caplog.clear()  # a column that counts is no quality, and no angle
    counted = [[k, a, r] for k, (_, a, r) in enumerate(rows)]
    for lines in (counted, [[k, r, a] for k, a, r in counted]):
        (scan,) = loaded(tmp_path, table([], lines)).scans
        np.testing.assert_allclose(scan.ranges, RANGES[0])
        np.testing.assert_allclose(scan.angles, np.deg2rad(np.arange(0, 360, 10)))
    assert "RPLIDAR" not in caplog.text


def test_a_table_of_windows_has_its_degrees(tmp_path: Path) -> None:
    rows = [[round(math.degrees(a), 6), r] for a, r in zip(ANGLES, RANGES[0], strict=True)]
    (tmp_path / "a.csv").write_text(table(["Winkel [°]", "Abstand [m]"], rows, ";"), "cp1252")
    np.testing.assert_allclose(load_scans(tmp_path / "a.csv")[0].angles, ANGLES, atol=1e-6)


def test_what_is_guessed_of_a_table_is_said(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    loaded(tmp_path, exported("time first"))
    assert "column 1 is taken for the time, not for ranges" in caplog.text
    degrees = [[math.degrees(a), r] for a, r in zip(ANGLES, RANGES[0], strict=True)]
    (scan,) = loaded(tmp_path, table([], degrees)).scans
    np.testing.assert_allclose(scan.angles, ANGLES)
    assert "they are taken for degrees" in caplog.text


def test_ranges_that_rise_are_no_angles_and_no_time(tmp_path: Path) -> None:
    rising = np.linspace(1, 2, RAYS) + np.arange(4)[:, None]
    assert loaded(tmp_path, VIEW + table([], rising.tolist()))[0].ranges[-1] == 2
    smooth = np.stack([[1, 1.02, 1.05], [1.1, 1.04, 1], [1.2, 1.1, 1.3], [1.3, 1.31, 1.2]])
    assert len(loaded(tmp_path, VIEW + table([], smooth.tolist()))[0].ranges) == 3
    few = [[3.1, 5, 6], [3.2, 4, 7]]
    assert len(loaded(tmp_path, VIEW + table([], few))[0].ranges) == 3


@pytest.mark.parametrize("kind", ["rostopic -p", "ros2 --csv", "a reading a line", "plotjuggler"])
def test_a_broken_line_of_a_table_is_left_out(tmp_path: Path, kind: str) -> None:
    lines = exported(kind).splitlines()
    lines[len(lines) // 2] = lines[len(lines) // 2].replace(f"{RANGES[3, 0]}", "far", 1)
    if kind == "a reading a line":
        lines[5] = "?,far,?,?"
    (tmp_path / "a.csv").write_text("\n".join(lines[:-1] + [lines[-1][:40]]))
    scans = load_scans(tmp_path / "a.csv", max_bad=0.3)
    assert N - 2 <= len(scans) <= N


def test_a_table_that_is_not_understood_says_which_columns_would_do(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="angles: missing, expected a first line '# angle_min="):
        loaded(tmp_path, table([], RANGES.tolist()))
    with pytest.raises(ScanError, match="got 'a=', expected a number; a table has lines such"):
        loaded(tmp_path, "a= -90.00 d= 1.230\n")


def test_a_scan_that_passes_0_degrees_is_one_scan(tmp_path: Path) -> None:
    angles = (np.linspace(225, 484, 260) % 360).round(2).tolist()
    lines = [[a, 2000 + k, 47] for k, a in enumerate(angles)]
    (scan,) = loaded(tmp_path, "#Angule\tDistance\tQuality\n" + table([], lines, " ")).scans
    np.testing.assert_allclose(scan.ranges, 2000 + np.arange(260))
    around = [[a % 360 + 0.5 * (a >= 360), 2000] for a in range(720)]
    assert [len(scan.ranges) for scan in loaded(tmp_path, table([], around)).scans] == [360, 360]


def test_odometry_may_have_a_yaw_and_units(tmp_path: Path) -> None:
    names = ["odom_x [mm]", "odom_y_mm", "odom_yaw_deg"]
    rows = [[1500, -500, 90, *scan] for scan in RANGES]
    scans = loaded(tmp_path, VIEW + table([*names, *(f"r{k}" for k in range(RAYS))], rows))
    np.testing.assert_allclose(scans.odom[0], [1.5, -0.5, np.pi / 2])


@pytest.mark.parametrize("head", [["x", "y"], ["x_m", "y_m"], ["x", "y", "z"], []])
def test_points_are_no_scan(tmp_path: Path, head: list[str]) -> None:
    points = np.stack((RANGES[0] * np.cos(ANGLES), RANGES[0] * np.sin(ANGLES), 0 * ANGLES), 1)
    with pytest.raises(ScanError, match="are points; expected columns angle and range: atan2"):
        loaded(tmp_path, table(head, points[:, : len(head) or 2].tolist()))


@pytest.mark.parametrize("form", [
    "angle: {a:.3f}, distance: {r}, intensity: 1008", "stamp:1,angle:{a:.3f},distance(m):{r}",
    "Zeitstempel;Winkel_Grad;Entfernung\n7;{a:.3f};{r}", "ángulo,distancia\n{a:.3f},{r}",
    "bearing (grad),r\n{g:.3f},{r}", "sep=;\ntheta;rho\n{t:.5f};{r}", "// degrees\n{a:.3f},{r},",
    "hoek;afstand\n{a:.3f};{r}", "ángulo [grados],d\n{a:.3f},{r}", "phi_deg r\n7 {a:.3f} {r}",
    "sensor: A1\nfov: 180\nangle_deg,range\n{a:.3f},{r}", "[INFO] angle: {a:.3f}, distance: {r}",
])  # fmt: skip
def test_a_reading_a_line_of_other_people_is_read(tmp_path: Path, form: str) -> None:
    *head, line = form.split("\n")
    rows = [line.format(a=math.degrees(t), g=200 * t / math.pi, t=t, r=r)
            for t, r in zip(ANGLES, RANGES[0], strict=True)]  # fmt: skip
    (tmp_path / "a.txt").write_text("\n".join([*head, *rows, ""]))
    (scan,) = load_scans(tmp_path / "a.txt").scans
    np.testing.assert_allclose(scan.angles, ANGLES, atol=1e-5)
    np.testing.assert_allclose(scan.ranges, RANGES[0])


def test_what_people_write_for_nothing(tmp_path: Path) -> None:
    for word in ("NA", "n/a", "#N/A", "None", "k.A.", "-", "1.#QNAN", "-1.#IND", ""):
        scan = loaded(tmp_path, f"{VIEW}1,2,{word},3\n1,{word},2,3\n")[0]
        assert np.isnan(scan.ranges).tolist() == [False, False, True, False]
    assert np.isposinf(loaded(tmp_path, f"{VIEW}1,2,∞,1.#INF\n")[0].ranges[2:]).all()
    with pytest.raises(ScanError, match="got 'far', expected a number; nan, or nothing, stands"):
        loaded(tmp_path, f"{VIEW}1,far,3\n")
    text = table([], [[a, r, a + r] for a, r in zip(ANGLES, ANGLES, strict=True)] * 2)
    with pytest.raises(ScanError, match="lines of 3 numbers, expected a first line of names: a"):
        loaded(tmp_path, text)
    broken = 'angle_min,angle_max,ranges\n-1,1,"[1. 2.\n  3.]"\n-1,1,"[1. 2.\n 5.]"\n'
    for first in ("1", "inf", "None"):
        scans = loaded(tmp_path, broken.replace("[1.", f"[{first}"))
        assert scans[1].ranges.tolist()[1:] == [2, 5]
    rows = loaded(tmp_path, '# angle_min=-1, angle_max=1\n"1" 2.01 2.05 2.07\n"2" 2.02 2.06 2.08\n')
    assert rows[0].ranges.tolist() == [2.01, 2.05, 2.07]  # R names its rows
    with pytest.raises(ScanError, match="printed shortened"):
        loaded(tmp_path, broken.replace("2.", "..."))
    with pytest.raises(ScanError, match="line 3: it was printed with four digits and a factor"):
        loaded(tmp_path, "ranges =\n\n  1.0e+03 *\n\n" + table([], RANGES.tolist(), "  "))


def test_lasers_of_one_table_are_told_apart(tmp_path: Path) -> None:
    two = {"front": RANGES[0], "rear": RANGES[1]}
    wide = table(["frame_id", *(f"r{k}" for k in range(RAYS))], [[n, *r] for n, r in two.items()])
    rows = [[n, *row] for n, r in two.items() for row in zip(ANGLES, r, strict=True)]
    for text in (VIEW + wide, table(["laser", "angle", "range"], rows)):
        with pytest.raises(ScanError, match=r"one of front \(1\), rear \(1\)"):
            loaded(tmp_path, text)
        np.testing.assert_allclose(loaded(tmp_path, text, topic="rear")[0].ranges, RANGES[1])
    for name in ("frame", "source"):  # a number of the scan, and its file, are no lasers
        said = [[k if name == "frame" else f"{k}.txt", *row] for k, (_, *row) in enumerate(rows)]
        assert len(loaded(tmp_path, table([name, "angle", "range"], said))) == 2
    beside = np.column_stack((ANGLES, RANGES[0], RANGES[1])).tolist()
    for names in (["laser1", "laser2"], ["weite", "guete"]):
        with pytest.raises(ScanError, match=f"columns {', '.join(names)} beside angles, expected"):
            loaded(tmp_path, table(["angle", *names], beside))


@pytest.mark.parametrize("name", ["name", "child_frame_id", "label", "id", "index", "n"])
def test_a_column_of_any_name_tells_lasers_apart(tmp_path: Path, name: str) -> None:
    lasers = ["0", "1"] if name == "index" else ["front", "rear"]
    wide = [[STAMPS[k], lasers[i], *RANGES[k - i]] for k in range(N) for i in range(2)]
    rows = [[t, w, *one] for t, w, *scan in wide for one in zip(ANGLES, scan, strict=True)]
    long = table(["stamp", name, "angle", "range"], rows)
    scans = SAID + table(["stamp", name, *(f"r{k}" for k in range(RAYS))], wide)
    for text in (long, scans) if name in ("id", "index") else (long,):
        with pytest.raises(ScanError, match=rf"one of {lasers[0]} \({N}\), {lasers[1]} \({N}\)"):
            loaded(tmp_path, text)
        one = loaded(tmp_path, text, topic=lasers[1])
        assert [scan.ranges.tolist() for scan in one.scans] == RANGES[np.arange(N) - 1].tolist()
    apart = loaded(tmp_path, table(["stamp", "angle", "range"], [[t, *row] for t, _, *row in rows]))
    assert {len(scan.ranges) for scan in apart.scans} == {RAYS}  # two a stamp, never one of both


ORDERS = (range(RAYS), range(RAYS)[::-1], [*range(0, RAYS, 2), *range(1, RAYS, 2)],
          [*range(20, RAYS), *range(20)], np.argsort(RANGES[0]).tolist())  # fmt: skip
BESIDE = ("status ok weak ok", "side left right", "echo 0 1", "id 1 2", "label wall", "source a")


@pytest.mark.parametrize("key", ["stamp", "scan"])
@pytest.mark.parametrize("order", ORDERS, ids=str)
def test_a_column_of_other_words_tells_no_lasers_apart(tmp_path: Path, key: str, order) -> None:
    for name, *words in map(str.split, BESIDE):
        rows = [[STAMPS[k], words[j % len(words)], ANGLES[i], RANGES[k][i]]
                for k in range(N) for j, i in enumerate(order)]  # fmt: skip
        text = table([key, name, "angle", "range"], rows, ",;\t"[len(name) % 3])
        scans = loaded(tmp_path, text).scans
        assert [scan.ranges.tolist() for scan in scans] == RANGES[:, list(order)].tolist()


def test_angles_beside_other_columns_are_found(tmp_path: Path) -> None:
    beside = table(["angle", "range1", "range2"], np.vstack((ANGLES, RANGES[:2])).T.tolist())
    assert loaded(tmp_path, beside)[1].ranges.tolist() == RANGES[1].tolist()
    places = ["stamp", "odom_x", "odom_y", "odom_theta"]
    yaw = [f"/odom/pose/pose/{w}" for w in ("position/x", "position/y", "orientation/yaw")]
    rows = [[STAMPS[k], k, 0, 0.5, *RANGES[k]] for k in range(N)]
    spaced = SAID + table(["stamp", *yaw, *(f"/ranges[{k}]" for k in range(RAYS))], rows)
    for text in (table([*places, *ANGLES.round(5).tolist()], rows), spaced):
        scans = loaded(tmp_path, text)
        np.testing.assert_allclose(scans[0].angles, ANGLES, atol=1e-5)
        np.testing.assert_allclose(scans.odom[2], [2, 0, 0.5])


def test_a_print_that_lacks_a_part_is_refused(tmp_path: Path) -> None:
    parts = {at: f"  Columns {at} through {at + 3}\n\n  1.0 2.0 3.0 4.0\n\n" for at in (1, 5, 9)}
    assert len(loaded(tmp_path, VIEW + "".join(parts.values()))[0].ranges) == 12
    with pytest.raises(ScanError, match="what was printed before it is missing"):
        loaded(tmp_path, VIEW + parts[1] + parts[9])


def test_a_comma_at_the_end_of_each_line_is_no_ray(tmp_path: Path) -> None:
    assert len(loaded(tmp_path, f"{VIEW}1,2,3,\n# next\n2,3,4,\n")[0].ranges) == 3
    assert len(loaded(tmp_path, f"{VIEW}1,2,3,\n2,,4,\n")[0].ranges) == 4


@pytest.mark.parametrize(("head", "metres"), [
    ("angle_deg,distance_mm", 1e-3), ("Angle (°);Range [cm]", 1e-2), ("phi in deg,dist/mm", 1e-3),
    ("angle_degrees,distance_in_mm", 1e-3), ("phi [deg]\tr [millimeters]", 1e-3),
    ("angle_deg,distance", 1.0), ("angle_deg,scan_1 [cm]", 1e-2), ("phi_deg,r [ft]", 0.3048),
    ("# unit: mm", 1e-3), ("# ranges are feet", 0.3048), ("# range_unit = 'cm'", 1e-2),
])  # fmt: skip
def test_the_units_of_a_head_win(tmp_path: Path, head: str, metres: float) -> None:
    mark = next((m for m in ";\t," if m in head), ",")
    rows = [[math.degrees(a), round(v)] for a, v in zip(ANGLES, 951 * RANGES[0], strict=True)]
    (scan,) = loaded(tmp_path, f"{head}\n" + table([], rows, mark)).scans
    np.testing.assert_allclose(scan.ranges, metres * np.round(951 * RANGES[0]))
    wide = table([f"r{k}_cm" for k in range(RAYS)], RANGES.tolist())
    (scan, *_) = loaded(tmp_path, VIEW + wide).scans
    np.testing.assert_allclose(scan.ranges, 0.01 * RANGES[0])


@pytest.mark.parametrize(("times", "unit"), [
    (1, "degrees"), (10, "tenths of a degree"), (100, "hundredths of a degree"),
    (1000 * math.pi / 180, "milliradians"),
])  # fmt: skip
def test_angles_without_a_unit_are_of_that_in_which_a_turn_fits(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch,
    times: float, unit: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    degrees = np.arange(0, 360, 360 / RAYS)
    rows = np.column_stack((RANGES[0], times * degrees, np.full(RAYS, 47)))
    for columns in ([1, 0], [0, 1], [0, 1, 2]):  # in either order, and with a quality
        (scan,) = loaded(tmp_path, table([], rows[:, columns].tolist())).scans
        np.testing.assert_allclose(scan.angles, np.deg2rad(degrees), atol=1e-6)
        np.testing.assert_allclose(scan.ranges, RANGES[0])
    assert f"they are taken for {unit}" in caplog.text
    assert "column 2 rises or falls evenly: it is taken for the angle" in caplog.text
    sector = [[a, 2.5] for a in np.linspace(-12, 12, 97)]
    assert np.ptp(loaded(tmp_path, table([], sector))[0].angles) == pytest.approx(np.deg2rad(24))
    with pytest.raises(ScanError, match="span 1000, expected radians or degrees; or call their"):
        loaded(tmp_path, table([], [[10 * k, 2.5] for k in range(101)]))


def test_what_the_sdk_of_rplidar_prints_is_read(tmp_path: Path) -> None:
    degrees = np.arange(0.5, 360, 10).tolist()
    lines = [f"{'S ' * (a < 1)} theta: {a:06.2f} Dist: {1000 * v:08.2f} Q: 47 "
             for row in RANGES for a, v in zip(degrees, row, strict=True)]  # fmt: skip
    lines[3], lines[40] = "   theta: 030.50 Dist: 00000.00 Q: 0 ", "Error, operation timeout"
    (tmp_path / "a.txt").write_text("\n".join(["Version: 2.0", "Firmware Ver: 1.29", *lines, ""]))
    scans = load_scans(tmp_path / "a.txt")
    assert [len(scan.ranges) for scan in scans.scans] == [RAYS, RAYS - 1, *[RAYS] * (N - 2)]
    np.testing.assert_allclose(scans[2].ranges, RANGES[2])
    np.testing.assert_allclose(scans[2].angles, -np.deg2rad(degrees))
    assert np.isposinf(scans[0].ranges[3])


def test_a_list_that_is_cut_off_in_a_cell_is_left_out(tmp_path: Path) -> None:
    text = exported("lists in cells")
    assert len(loaded(tmp_path, text[:-120])) == N - 1


def test_angles_that_were_rounded_and_a_time_without_a_name(tmp_path: Path) -> None:
    scans = loaded(tmp_path, exported("rounded angles first"))
    assert len(scans) == N
    np.testing.assert_allclose(scans[0].angles, np.linspace(-np.pi / 2, np.pi / 2, 361), atol=0.006)
    scans = loaded(tmp_path, exported("names that say nothing"))
    assert len(scans[0].ranges) == RAYS
    np.testing.assert_allclose(scans.stamps, 0.1 * np.arange(N))


@pytest.mark.parametrize("said", ["angle_min=-90, angle_max=90", "angle_min=nan, angle_max=1"])
def test_a_view_that_is_stated_wins_over_angles_that_cannot_be(tmp_path: Path, said: str) -> None:
    (tmp_path / "a.csv").write_text(f"# {said}\n" + table([], RANGES.tolist()))
    with pytest.raises(ScanError, match=r"angle.*; or pass `fov`"):
        load_scans(tmp_path / "a.csv")
    scans = load_scans(tmp_path / "a.csv", fov=np.pi)
    np.testing.assert_allclose(scans[0].angles, ANGLES)


@pytest.mark.parametrize("step", ["0", "1e-320", "inf"])
def test_an_echo_whose_step_cannot_be_is_left_out(tmp_path: Path, step: str) -> None:
    line = "{},0,laser,-1.0,1.0,{},0,0.1,0.05,30,1,2,3,4,5\n"
    path = tmp_path / "a.csv"
    path.write_text(line.format(1, step))
    with pytest.raises(ScanError, match="line 1: angle"):
        load_scans(path)
    path.write_text("".join(line.format(t, s) for t, s in ((1, step), (2, 0.5), (3, 0.5))))
    assert len(load_scans(path, max_bad=0.5)) == 2


@pytest.mark.parametrize(("rest", "warned"), [(0, True), (47, True), (np.inf, False)])
def test_a_half_of_each_line_that_is_one_number(tmp_path: Path, caplog, rest, warned) -> None:
    (tmp_path / "a.csv").write_text(table([], [[*row, *[rest] * RAYS] for row in RANGES.tolist()]))
    if warned:
        with pytest.raises(ScanError, match=f"`fov`; after {RAYS} columns each line is {rest}: if"):
            load_scans(tmp_path / "a.csv")
    assert len(load_scans(tmp_path / "a.csv", fov=np.pi)[0].ranges) == 2 * RAYS
    assert ("each line is" in caplog.text) == warned  # open space is no intensity


def test_a_cell_longer_than_any_is_a_broken_line(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f'"{"a" * 200_000}",1,2\n')
    with pytest.raises(ScanError, match="line 1: column 1"):
        load_scans(tmp_path / "a.csv", fov=1.0)
