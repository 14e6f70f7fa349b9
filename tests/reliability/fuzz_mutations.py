"""Files changed at random, the same again for the same random numbers."""

from __future__ import annotations

import copy
import json
import re
import sqlite3
import sys
from contextlib import closing, suppress

from lxml import etree

from helpers.checksums import reseal

NUMBERS = (
    "nan", "inf", "-inf", "0", "-0", "-1", "1", "2", "0.5", "1e308", "-1e308", "1e300", "-1e300", "1e-308", "5e-324", "1e20", "1e9",
    "-1e9", "1e6", "65536", "2147483648", "-2147483649", "4294967295", "9223372036854775807", "9223372036854775808",
    "99999999999999999999", "-99999999999999999999", "1e5", "1e400", "9" * 400, "9" * 5000, "1_000", "0x10", "١٢", "1,5", "1e",
)  # fmt: skip
TEXTS = (
    "", " ", "x", "Ego", "B", "$v", "$nothing", "${1/0}", "${$v*1e308}", "${pow(10,400)}", "${" + "(" * 300, "true", "false", "null", "*",
    "=1+1", "[/b]", "[red]a", "é\u202e", "a" * 5000, "../../../etc/passwd", "/etc/passwd", "/dev/zero", "/proc/self/environ",
    "http://198.51.100.1/a", "\\\\198.51.100.1\\a", "a:b", "{", "'", '"', "-", "%s{0}", "\t", "a\nb", "CON", "..", "/",
)  # fmt: skip
BYTES = (
    b"", b"\0", b"\0" * 8, b"\xff" * 4, b"\xff" * 8, b"\0\0\0\0\0\0\xf0\x7f", b"\0\0\0\0\0\0\xf8\x7f", b"\0\0\x80\x7f", b"\0\0\xc0\x7f",
    b"\xff\xff\xff\xff\xff\xff\xef\x7f", b"\xff\xff\x7f\x7f", b"\0\0\0\x80", b"\xff\xff\xff\x7f", b"\x1b[2J", b"\xef\xbb\xbf", b"\xff\xfe",
    b"\xc3", b"<!DOCTYPE a>", b"<![CDATA[", b"-->", b"]]>", b"&a;", b'"', b"\r", b"\n\n", b",,", b"{", b"[" * 2000, b"<a>" * 2000,
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def extreme(rng):
    return rng.choice(NUMBERS) if rng.random() < 0.7 else rng.choice(TEXTS)


def mutated_bytes(data: bytes, rng) -> bytes:
    """Bits flipped, parts cut, doubled, moved or overwritten, numbers made extreme."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        begin = rng.randrange(len(data) + 1)
        end = min(len(data), begin + rng.choice((1, 1, 2, 4, 8, 16, 100, 1000)))
        kind = rng.randrange(8)
        if kind == 0 and data:
            one = rng.randrange(len(data))
            data = data[:one] + bytes([data[one] ^ 1 << rng.randrange(8)]) + data[one + 1 :]
        elif kind == 1:
            data = data[:begin]
        elif kind == 2:
            data = data[:begin] + data[end:]
        elif kind == 3:
            data = data[:end] + data[begin:end] * rng.choice((1, 2, 50)) + data[end:]
        elif kind == 4:
            piece = rng.choice(BYTES)
            data = data[:begin] + piece + data[begin:]
        elif kind == 5:
            piece = rng.choice(BYTES)
            data = data[:begin] + piece + data[begin + len(piece) :]
        else:
            found = list(_NUMBER.finditer(data))
            if found:
                one = rng.choice(found)
                data = data[: one.start()] + extreme(rng).encode() + data[one.end() :]
    return data


def mutated_text(data: bytes, rng) -> bytes:
    """Numbers and words of a text made extreme, rows and cells moved, as well as bytes."""
    kind = rng.randrange(5)
    lines = data.split(b"\n")
    if kind == 0:
        return mutated_bytes(data, rng)
    if kind == 1:
        one = rng.randrange(len(lines))
        lines[one : one + 1] = rng.choice(([], [lines[one]] * 2, [lines[one]] * 200, [b""], list(reversed(lines))))
    elif kind == 2:
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[one], lines[other] = lines[other], lines[one]
    else:
        for _ in range(rng.choice((1, 1, 2, 5))):
            one = rng.randrange(len(lines))
            cells = re.split(rb"([,=;\s])", lines[one])
            cells[2 * rng.randrange(len(cells) // 2 + 1)] = extreme(rng).encode()
            lines[one] = b"".join(cells)
    return b"\n".join(lines)


def mutated_xml(data: bytes, rng) -> bytes:
    """Attributes made extreme, elements removed, doubled, moved, renamed or nested deep."""
    if rng.random() < 0.15:
        return mutated_bytes(data, rng)
    root = etree.fromstring(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        elements = [one for one in root.iter("*") if one is not root] or [root]
        one, other = rng.choice(elements), rng.choice(elements)
        kind = rng.randrange(14)
        names = list(one.attrib)
        if kind < 7:
            with_some = [each for each in elements if each.attrib] or [root]
            one = rng.choice(with_some)
            if one.attrib:
                name = rng.choice(list(one.attrib))
                one.set(name, rng.choice((extreme(rng), other.get(name, extreme(rng)))) if kind else extreme(rng))
        elif kind == 7 and names:
            del one.attrib[rng.choice(names)]
        elif kind == 8:
            if one.getparent() is not None:
                one.getparent().remove(one)
        elif kind == 9:
            if one.getparent() is not None:
                for _ in range(rng.choice((1, 1, 30))):
                    one.addnext(copy.deepcopy(one))
        elif kind == 10:
            if one is not other and other not in one.iterancestors():
                one.append(other)
        elif kind == 11:
            one.tag = other.tag
        elif kind == 12:
            one.text = extreme(rng).replace("\0", "")
        else:
            inner = one
            for _ in range(rng.choice((1, 3, 250))):
                inner = etree.SubElement(inner, one.tag, dict(one.attrib))
    return etree.tostring(root)


def mutated_json(data: bytes, rng) -> bytes:
    """Values made extreme or of another type, removed, doubled, or nested deep."""
    if rng.random() < 0.15:
        return mutated_bytes(data, rng)
    usual = sys.getrecursionlimit()
    # What is nested deep is copied and written here, but read with the limit that users have.
    sys.setrecursionlimit(20 * usual)
    try:
        value = json.loads(data)
        for _ in range(rng.choice((1, 1, 2))):
            value = _changed(value, rng)
        return json.dumps(value).encode("utf-8", "surrogatepass")
    finally:
        sys.setrecursionlimit(usual)


def strange_value(rng):
    deep: object = []
    for _ in range(rng.choice((3, 900))):
        deep = [deep]
    return rng.choice((
        None, True, False, 0, -1, 1, 2.5, float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, 10**20, -(10**20), 10**400, 2**63,
        "", "\ud800", "\0", [], {}, [1], {"a": 1}, [[]], deep, extreme(rng),
    ))  # fmt: skip


def _changed(value, rng):
    places = []

    def look(one):
        for key in list(one) if isinstance(one, dict) else range(len(one)):
            places.append((one, key))
            if isinstance(one[key], dict | list):
                look(one[key])

    if isinstance(value, dict | list):
        look(value)
    if not places:
        return strange_value(rng)
    where, key = rng.choice(places)
    kind = rng.randrange(6)
    if kind == 0:
        del where[key]
    elif kind == 1 and isinstance(where, list):
        where.append(copy.deepcopy(where[key]))
    elif kind == 1:
        where[extreme(rng)] = where.pop(key)
    elif kind == 2:
        other, there = rng.choice(places)
        where[key] = (
            copy.deepcopy(other[there]) if there in other or (isinstance(other, list) and there < len(other)) else None
        )
    else:
        where[key] = strange_value(rng)
    return value


def mutated_database(path, rng) -> None:
    """One or two cells of a study made strange, rows removed, or its bytes changed; most get checksums that fit."""
    if rng.random() < 0.25:
        path.write_bytes(mutated_bytes(path.read_bytes(), rng))
        return
    _change_cells(path, rng)
    if rng.random() < 0.75:
        # What cannot have one keeps that of before.
        with suppress(sqlite3.Error, TypeError, ValueError, OverflowError):
            reseal(path)


def _change_cells(path, rng) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        tables = [
            name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
        ]
        for _ in range(rng.choice((1, 1, 2))):
            table = rng.choice(tables)
            about = connection.execute(f"PRAGMA table_info({table})").fetchall()
            columns, keys = [one[1] for one in about], [one[0] for one in about if one[5]]
            rows = connection.execute(f"SELECT * FROM {table} ORDER BY 1, 2").fetchall() if keys else []
            if not rows:
                continue
            row, column = rng.choice(rows), rng.randrange(len(columns))
            where = " AND ".join(f"{columns[key]} = ?" for key in keys)
            named = [row[key] for key in keys]
            if rng.random() < 0.1:
                connection.execute(f"DELETE FROM {table} WHERE {where}", named)
                continue
            value = _strange_cell(row[column], rng)
            # What the schema refuses stays as it was.
            with suppress(sqlite3.Error, OverflowError):
                connection.execute(f"UPDATE {table} SET {columns[column]} = ? WHERE {where}", (value, *named))


def _strange_cell(before, rng):
    if isinstance(before, str) and before[:1] in "{[" and rng.random() < 0.8:
        return mutated_json(before.encode("utf-8", "replace"), rng).decode("utf-8", "replace")
    if isinstance(before, bytes) and rng.random() < 0.7:
        return mutated_bytes(before, rng)
    return rng.choice((
        None, 0, -1, 1, 2, 2**62, -(2**63), 1e308, -1e308, float("inf"), -float("inf"), 5e-324, "", "nan", "x", "../../a", b"", b"\xff" * 9,
        "\x1b[2J", extreme(rng),
    ))  # fmt: skip


def mutated_words(words: list[str], rng) -> list[str]:
    """Values of a command line, one or two of which are changed."""
    words = list(words)
    for _ in range(rng.choice((1, 1, 1, 2))):
        one = rng.randrange(len(words))
        word = words[one]
        kind = rng.randrange(5)
        if kind == 0:
            pieces = re.split(r"([ =:,.()<>]|(?<=\d)(?=\D))", word)
            pieces[rng.randrange(len(pieces))] = extreme(rng)
            words[one] = "".join(filter(None, pieces))
        elif kind == 1:
            words[one] = mutated_bytes(word.encode(), rng).decode("utf-8", "replace").replace("\0", "")
        elif kind == 2:
            words[one] = extreme(rng)
        elif kind == 3:
            words[one] = word + rng.choice((word, " and " + word, "(" * 400, ")" * 3, " " * 300, " or not" * 300))
        else:
            numbers = list(re.finditer(r"\d+(\.\d+)?", word))
            if numbers:
                which = rng.choice(numbers)
                words[one] = word[: which.start()] + rng.choice(NUMBERS) + word[which.end() :]
    return words
