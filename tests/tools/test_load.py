"""The load of a service, in short."""

import re

from tools.load import main


def test_no_request_is_lost_and_the_service_ends(capsys) -> None:
    code = main(["--requests", "24", "--clients", "4", "--pairs", "3", "--near"])
    said = capsys.readouterr().out
    assert code == 0, said
    assert "status {200: 24}; 0 without an answer" in said
    assert said.endswith("exit code 0\n")


def test_clients_lose_nothing_beside_a_crowd(capsys) -> None:
    code = main(["--crowd", "1", "--map", "curved"])
    said = capsys.readouterr().out
    assert code == 0, said
    assert re.search(r"beside a crowd: \d+ requests, p50 .* p99 .*; 0 lost", said)
    assert "p99 beside / alone: " in said
    assert "exit code 0" in said
