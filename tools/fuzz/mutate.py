"""Valid samples, made hostile: by bytes, by words and numbers, and within archives.

Nothing here knows a format but ZIP and PNG, whose checksums are mended: what is behind them would
not be reached otherwise.
"""

import io
import random
import re
import zipfile
import zlib
from collections.abc import Sequence

LONGEST = 1 << 18
"""Bytes of an input, at most."""

_TOKEN = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?|\w+|\s+|[^\w\s]")
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_NUMBERS = (
    b"0 -0 -1 1 2 1e-300 1e9 -1e9 1e300 1e999 -1e999 nan NaN .nan inf -inf Infinity .inf 0.1.2 "
    b"1,5 0x7fffffff 0b1 0o17 1_000 127 128 255 256 32767 65535 65536 2147483647 2147483648 "
    b"4294967295 4294967296 9223372036854775807 18446744073709551616 1:30 2024-13-45"
).split()
_NUMBERS += [b"9" * 400, b"0x" + b"f" * 4000, b"9" * 5000, "٣".encode()]
_WORDS = (
    b'null true false [] {} [[]] [null] [{}] "" \'\' "x" [1] {"x":1} - : , ; # & * ! | > % @ ` '
    b"&a *a &a[*a] <<: !!python/name:os.system !!binary !!set ? --- ... /etc/passwd /dev/zero "
    b"../.. . / -- =1+1 \\u0000 \\ud800 $(id) {{7*7}} <script> %s %n"
).split()
_WORDS += [
    b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\x1b]0;x\x07", "\u202e\u2028".encode(), b"\r", b"\n",
    b"\t", b"\xed\xa0\x80", b"a" * 300, b"/" * 5000, b'"\\', b"\n\n", b"\x89PNG\r\n\x1a\n",
    b"PK\3\4",
]  # fmt: skip
_PRINTED = bytes(range(9, 127))
_OPENING = (b"[", b"{", b"(", b'{"a":', b"- ", b"[[", b"&a [*a,", b"? ", b"\n", b" ", b"1 ", b"1,")


def mutate(rng: random.Random, samples: Sequence[bytes]) -> bytes:
    """One input: a sample with up to four changes; now and then the sample as it is.

    Examples
    --------
    >>> mutate(random.Random(3), [b"1.5, 2"]) == mutate(random.Random(3), [b"1.5, 2"])
    True
    """
    data = rng.choice(samples)
    if rng.random() < 0.01:
        return data
    if data[:4] == b"PK\3\4" and rng.random() < 0.8:
        return _within(rng, data)
    png = data.startswith(b"\x89PNG") and rng.random() < 0.8
    data = _changed(rng, data, samples)
    return _checked(data) if png else data


_BY_BYTE = ("flip", "flip", "number", "cut", "delete", "repeat", "splice", "insert", "nest")
_BY_WORD = ("numeral", "numeral", "numeral", "word", "word", "word", "delete", "splice", "nest")


def _changed(rng: random.Random, data: bytes, samples: Sequence[bytes]) -> bytes:
    textual = 10 * len(data.translate(None, _PRINTED)) < len(data)  # a header of bytes is fine
    # Where only numbers change, the rest of the way is seen, too.
    tame = ("numeral" if textual else "number",) if rng.random() < 0.4 else None
    for _ in range(rng.choice((1, 1, 1, 1, 1, 2, 2, 3, 4))):
        some = _BY_WORD if rng.random() < (0.8 if textual else 0.2) else _BY_BYTE
        data = _change(rng, rng.choice(tame or some), data, samples)[:LONGEST]
    return data


def _place(rng: random.Random, data: bytes) -> int:
    """A place, more often among the first bytes: headers are there."""
    end = len(data) if rng.random() < 0.5 else min(len(data), 128)
    return rng.randrange(end) if end else 0


def _change(rng: random.Random, kind: str, data: bytes, samples: Sequence[bytes]) -> bytes:
    at = start = _place(rng, data)
    end, new = at, b""
    if kind == "flip" and data:
        end, new = at + 1, bytes([data[at] ^ 1 << rng.randrange(8)])
    elif kind == "number":  # near one of the ends of what 1, 2, 4 or 8 bytes can be
        size = rng.choice((1, 2, 4, 8))
        value = rng.choice((0, 1, 1 << 8 * size - 1, 1 << 4 * size)) + rng.randint(-2, 2)
        order = rng.choice(("little", "big"))
        end, new = at + size, (value % (1 << 8 * size)).to_bytes(size, order)  # type: ignore[arg-type]
    elif kind == "cut":
        end = len(data)
    elif kind == "delete":
        end = at + int(2 ** rng.uniform(0, 10))
    elif kind == "repeat":
        part = data[at : at + int(2 ** rng.uniform(0, 10))]
        new = part * min(int(2 ** rng.uniform(1, 12)), LONGEST // max(1, len(part)))
    elif kind == "splice":
        other = rng.choice(samples)
        end, new = len(data), other[_place(rng, other) :]
    elif kind == "insert":
        new = rng.choice((*_WORDS, rng.randbytes(4)))
    elif kind == "nest":  # what recurses has an end
        new = rng.choice(_OPENING) * int(2 ** rng.uniform(1, 17))
    elif found := list((_NUMBER if kind == "numeral" else _TOKEN).finditer(data, at))[:256]:
        start, end = (where := rng.choice(found)).span()
        if kind == "numeral":
            plain = f"{rng.choice((-1, 1)) * 10 ** rng.uniform(-6, 12):.{rng.randrange(4)}f}"
            new = rng.choice((*_NUMBERS, rng.choice(_WORDS), *[plain.encode()] * len(_NUMBERS)))
        else:  # also one that is somewhere else in the text
            new = rng.choice((rng.choice(_WORDS), rng.choice(found)[0], where[0] * 2))
    return data[:start] + new + data[end:]


def _within(rng: random.Random, data: bytes) -> bytes:
    """A ZIP archive in which a member is changed, and which is well otherwise."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info, archive.read(info)) for info in archive.infolist()]
    at, out = rng.randrange(len(members)), io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for k, (info, content) in enumerate(members):
            if k == at:
                content = _changed(rng, content, [content for _, content in members])
            name = info.filename if rng.random() < 0.98 else f"{k}x"
            kind = info.compress_type if rng.random() < 0.95 else zipfile.ZIP_DEFLATED
            archive.writestr(zipfile.ZipInfo(name), content, kind)
    return out.getvalue()


def _checked(data: bytes) -> bytes:
    """A PNG in which the checksums of the chunks are right, as long as there are chunks."""
    out, at = bytearray(data), 8
    while at + 12 <= len(out):
        end = at + 8 + int.from_bytes(out[at : at + 4], "big")
        if end + 4 > len(out):
            break
        out[end : end + 4] = zlib.crc32(out[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(out)
