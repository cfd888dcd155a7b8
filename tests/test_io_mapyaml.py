"""The map's YAML: what is accepted although PyYAML would not, and what is refused."""

import math
from pathlib import Path

import pytest
from badfiles import YAML, yaml_with
from hypothesis import given
from hypothesis import strategies as st

from imgloc import MapError, Pose2D
from imgloc.io.mapyaml import MapYaml, load_map_yaml, parse_map_yaml


def parse(text: str) -> MapYaml:
    return parse_map_yaml(text.encode(), Path("folder/map.yaml"))


def test_all_keys() -> None:
    text = YAML.replace("[0.0, 0.0, 0.0]", "[-12.5, 3, 1.5]") + "mode: Scale\n"
    assert parse(text) == MapYaml(
        Path("folder/map.yaml"),
        Path("folder/good.png"),
        0.1,
        Pose2D(-12.5, 3.0, 1.5),
        "scale",
        negate=False,
        occupied_thresh=0.65,
        free_thresh=0.196,
    )


def test_what_is_not_said_is_none() -> None:
    y = parse("image: a.png\n")
    assert (y.resolution, y.origin, y.mode, y.negate, y.occupied_thresh, y.free_thresh) == (
        None,
    ) * 6


@pytest.mark.parametrize(
    ("written", "value"),
    [("5e-2", 0.05), ("5E-2", 0.05), (".05", 0.05), ("'0.05'", 0.05), ("+1", 1.0), ("1.", 1.0)],
)
def test_numbers_that_pyyaml_reads_as_strings(written: str, value: float) -> None:
    assert parse(yaml_with("resolution", f"resolution: {written}")).resolution == value


def test_origin_of_string_like_numbers_and_negative_yaw() -> None:
    y = parse(yaml_with("origin", "origin: [-.5, 1e1, -3.5]"))
    assert (y.origin.x, y.origin.y) == (-0.5, 10.0)
    assert y.origin.theta == pytest.approx(-3.5 + 2 * math.pi)


@pytest.mark.parametrize(
    ("written", "value"),
    [("0", False), ("1", True), ("true", True), ("false", False), ("no", False)],
)
def test_negate_as_number_or_truth(written: str, value: bool) -> None:
    assert parse(yaml_with("negate", f"negate: {written}")).negate is value


@pytest.mark.parametrize("value", ["0.001", "10"])
def test_resolution_limits_are_allowed(value: str) -> None:
    assert parse(yaml_with("resolution", f"resolution: {value}")).resolution == float(value)


@pytest.mark.parametrize("value", ["0.00099", "10.1"])
def test_beyond_the_resolution_limits(value: str) -> None:
    with pytest.raises(MapError, match=f"resolution: got {value}, expected metres per cell"):
        parse(yaml_with("resolution", f"resolution: {value}"))


@pytest.mark.parametrize("key", ["occupied_thresh", "free_thresh"])
def test_thresholds_are_occupancies(key: str) -> None:
    assert getattr(parse(yaml_with(key, f"{key}: 1")), key) == 1.0
    with pytest.raises(MapError, match=f"{key}: got 1.5, expected an occupancy from 0 to 1"):
        parse(yaml_with(key, f"{key}: 1.5"))


def test_unknown_keys_are_kept_for_the_map_check() -> None:
    found = parse(YAML + "free_tresh: 0.2\nname: lab\n")
    assert found.unknown_keys == ("free_tresh", "name")
    assert found.slips == ["free_tresh"]  # warned of wherever the map is read


def test_image_path_is_relative_to_the_yaml_or_absolute() -> None:
    assert parse(yaml_with("image", "image: ../png/a b.png")).image == Path("folder/../png/a b.png")
    assert parse(yaml_with("image", "image: /abs/a.png")).image == Path("/abs/a.png")


def test_byte_order_mark_and_crlf(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + YAML.replace("\n", "\r\n").encode())
    assert load_map_yaml(path).resolution == 0.1


def test_a_message_names_file_key_value_and_expectation() -> None:
    with pytest.raises(MapError) as caught:
        parse(yaml_with("resolution", "resolution: 0,05"))
    assert str(caught.value) == (
        "folder/map.yaml: resolution: got '0,05', expected metres per cell, 0.001 to 10; "
        "write a decimal point, not a comma; or pass `resolution`"
    )


def test_long_values_are_cut_in_messages() -> None:
    with pytest.raises(MapError) as caught:
        parse(yaml_with("mode", "") + "mode: " + "x" * 1000)
    assert len(str(caught.value)) < 150


@given(st.binary(max_size=40), st.integers(0, len(YAML)), st.integers(0, 20))
def test_garbage_gives_a_map_error_or_a_map(junk: bytes, at: int, cut: int) -> None:
    text = YAML.encode()
    message = "g.yaml: "
    try:
        parsed = parse_map_yaml(text[:at] + junk + text[at + cut :], Path("g.yaml"))
        assert parsed.resolution is None or 0.001 <= parsed.resolution <= 10
    except MapError as e:
        message = str(e)
    assert message.startswith("g.yaml: ")
    assert "\n" not in message
