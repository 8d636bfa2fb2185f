"""Ways to damage a file; all randomness comes from the generator that is handed in."""

from __future__ import annotations

import copy
import csv
import io
import json
import re
from collections.abc import Callable
from random import Random
from typing import Any

import yaml

Mutator = Callable[[Random, bytes], bytes]

_NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 7, 255, 65536, 2**31, 2**53 + 1, 2**63, 2**64, 10**30, 10**80,
    0.0, -0.0, 1e-300, 5e-324, 1e-9, 0.5, 1e3, 1e6, 1e9, 1e15, 1e30, 1e300, -1e300, 1.7976931348623157e308,
    float("nan"), float("inf"), float("-inf"),
)  # fmt: skip
_TEXTS = (
    "", " ", "x", "$x", "$position", "z_up", "true", "1", "1e5", "nan", "off", "../../etc/passwd",
    "/etc/passwd",
    "a/b", "..", ".", "a\x00b", "\u202e", "\U0001f600", "\ud83d", "é", "<script>alert(1)</script>",
    "=cmd|'/C calc'!A0",
    "{{ 7*7 }}", "%s%n", "emulator://table?world=/etc/passwd", "emulator://table?seed=-1", "x" * 300,
    "x" * 70_000,
    "a.b.c", "HEADING.HEADING", "NO.SUCH", "gyrobench_ins.dbc", "<<", "=", "~", "null", "!!int x", "-",
    ":", "1\n2",
)  # fmt: skip
#: YAML that a dump never writes, put in the place of a value.
_RAW_YAML = (
    '!!python/object/apply:os.system ["touch gyrobench_was_here"]',
    "!!python/name:os.system ''",
    "!!python/object:gyrobench.bench.foundations.documents.Document {}",
    "!!binary aGVsbG8=",
    "!!set {a, b}",
    "!!omap [a: 1]",
    "!!timestamp 2026-01-01",
    "!!int 0x1F",
    "!!float abc",
    "!!null x",
    "!unknown {a: 1}",
    "&a [*a, *a]",
    "&a {k: *a}",
    "*undefined",
    "{<<: {a: 1}}",
    "{<<: [{a: 1}, {b: 2}]}",
    "{? [a, b] : 1}",
    "{? {a: 1} : 1}",
    "{a: 1, a: 2}",
    "[&x [1,1,1,1,1,1,1,1,1], &y [*x,*x,*x,*x,*x,*x,*x,*x], &z [*y,*y,*y,*y,*y,*y,*y,*y], "
    "[*z,*z,*z,*z,*z,*z,*z,*z]]",
    "[" * 60 + "]" * 60,
    "[" * 3000 + "]" * 3000,
    "{a: " * 2000 + "1" + "}" * 2000,
    "[" + "1," * 60_000 + "]",
    '"\\ud800"',
    '"\\U00110000"',
    '"\\x00"',
    "1_000",
    "010",
    "0x1F",
    "1e400",
    "9" * 5000,
    "2026-01-01",
    "12:30:00",
    "? x",
    "- x",
    "|\n  text",
    "'unclosed",
    "[unclosed",
    "@x",
    "%x",
    "`x`",
    "--- x",
    "\t1",
)  # fmt: skip
_CELLS = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e400", "-1e400", "1e308", "-1e308", "1e-320", "0", "-0", "1",
    "-1", "1.5",
    "1e30", "0x10", "1_000", "１２", "١", "+1", "1,5", "1.2.3", "--1", "9" * 19, "9" * 18, "9" * 4000, "x",
    "=1+1",
    "=cmd|'/C calc'!A0", "@x", '"', '""', "a\x00b", "\u2028", "<b>", "z_up", "none", "x" * 200_000, "a\nb",
)  # fmt: skip


def damaged_bytes(random: Random, data: bytes) -> bytes:
    """Flip, cut, insert, repeat, overwrite."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 4, 16))):
        at = random.randrange(len(changed) + 1)
        length = random.choice((1, 1, 2, 4, 8, 64, 1000))
        match random.randrange(8):
            case 0 if at < len(changed):
                changed[at] ^= 1 << random.randrange(8)
            case 1:
                del changed[at:]
            case 2:
                changed[at:at] = random.randbytes(length)
            case 3:
                del changed[at : at + length]
            case 4:
                source = random.randrange(len(changed) + 1)
                changed[at:at] = changed[source : source + length]
            case 5:
                changed[at : at + length] = bytes([random.choice((0, 255, 10, 32, 34))]) * length
            case 6:
                number = random.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**16, len(data)))
                changed[at : at + 4] = number.to_bytes(4, random.choice(("little", "big")))
            case 7:
                del changed[:at]
    return bytes(changed)


def _encoded(random: Random, text: str) -> bytes:
    """Text as bytes, now and then as no text should be."""
    plain = text.encode("utf-8", "surrogatepass")
    at = random.randrange(len(plain) + 1)
    match random.randrange(40):
        case 0:
            return b"\xef\xbb\xbf" + plain
        case 1:
            return plain.replace(b"\n", b"\r\n")
        case 2:
            return plain.replace(b"\n", b"\r")
        case 3:
            return text.encode("utf-16", "surrogatepass")
        case 4:
            return plain[:at] + b"\x00" + plain[at:]
        case 5:
            return plain[:at] + random.choice((b"\xe9", b"\xff", b"\xc0\xaf", b"\xed\xa0\x80")) + plain[at:]
        case 6:
            return plain[:at]
        case 7:
            return random.choice(
                (b"", b"\n", b" ", b"\x00", b"\xff\xfe", b"#", b"---", b"{", b"[]", b"null", b"1")
            )
        case 8:
            return random.randbytes(random.randrange(2000))
        case 9:
            return plain + plain
        case 10:
            return (
                plain
                + b"\n"
                + random.choice((b"#", b" ", b"x", b"\n")) * random.choice((10, 5000, 2_000_000))
            )
        case _:
            return plain


def _places(tree: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [at]
    if isinstance(tree, dict):
        for key, value in tree.items():
            found += _places(value, (*at, key))
    elif isinstance(tree, list):
        for index, value in enumerate(tree):
            found += _places(value, (*at, index))
    return found


def _at(tree: Any, place: tuple[Any, ...]) -> Any:
    for part in place:
        tree = tree[part]
    return tree


def _any_value(random: Random, raw: list[str]) -> Any:
    match random.randrange(9):
        case 0 | 1 | 2:
            return random.choice(_NUMBERS)
        case 3 | 4:
            return random.choice(_TEXTS)
        case 5:
            return random.choice((True, False, None, [], {}, [[]], {"a": 1}, [0] * 20, ["x"], {"": ""}))
        case 6:
            nested: Any = 1
            for _ in range(random.choice((3, 30, 60))):
                nested = [nested] if random.random() < 0.5 else {"a": nested}
            return nested
        case _:
            raw.append(random.choice(_RAW_YAML))
            return f"@@{len(raw) - 1}@@"


def _changed_number(random: Random, value: float) -> float:
    factor = random.choice((-1, 0, 0.999999, 1.01, 2, 10, 1000, 1e6, 1e-3, 1e-6))
    changed = value * factor
    return type(value)(changed) if abs(changed) < 1e300 else changed


def _changed_tree(random: Random, tree: Any, raw: list[str]) -> Any:
    """Change one place of a tree of dicts and lists, in place where it can be."""
    places = _places(tree)
    place = random.choice(places)
    if not place:
        return _any_value(random, raw) if random.random() < 0.2 else tree
    parent, key = _at(tree, place[:-1]), place[-1]
    value = parent[key]
    match random.randrange(10):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            name = str(key)
            at = random.randrange(len(name) + 1)
            del parent[key]
            parent[random.choice((name[:at] + "x" + name[at:], name.upper(), name[1:], *_TEXTS))] = value
        case 2 if isinstance(parent, list):
            parent.insert(random.randrange(len(parent) + 1), copy.deepcopy(value))
        case 3 if isinstance(parent, list):
            random.shuffle(parent)
        case 4:
            parent[key] = copy.deepcopy(_at(tree, random.choice(places)))
        case 5 if isinstance(parent, dict):
            raw.append(random.choice(_RAW_YAML))
            parent[f"@@{len(raw) - 1}@@"] = value
        case 6 if isinstance(value, str) and value:
            at = random.randrange(len(value))
            parent[key] = value[:at] + random.choice(_TEXTS) + value[at + 1 :]
        case 7 | 8 if isinstance(value, int | float) and not isinstance(value, bool):
            parent[key] = _changed_number(random, value)
        case _:
            parent[key] = _any_value(random, raw)
    return tree


def _with_raw(text: str, raw: list[str]) -> str:
    for index, snippet in enumerate(raw):
        text = re.sub(rf"'?\"?@@{index}@@'?\"?", lambda _, snippet=snippet: snippet, text)
    return text


def damaged_yaml(random: Random, data: bytes) -> bytes:
    """Change the tree of a YAML file, or its bytes."""
    if random.random() < 0.15:
        return damaged_bytes(random, data)
    tree, raw = yaml.load(data, yaml.SafeLoader), list[str]()
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        tree = _changed_tree(random, tree, raw)
    # Aliases are wanted: a dump without them can be endless.
    text = yaml.safe_dump(
        tree, sort_keys=False, allow_unicode=True, default_flow_style=random.choice((None, False, True))
    )
    lines = _with_raw(text, raw).split("\n")
    if random.random() < 0.05:
        at = random.randrange(len(lines))
        lines.insert(random.randrange(len(lines) + 1), lines[at])
    return _encoded(random, "\n".join(lines))


def damaged_json(random: Random, data: bytes) -> bytes:
    """Change the tree of a JSON file, or its bytes."""
    if random.random() < 0.2:
        return damaged_bytes(random, data)
    tree, raw = json.loads(data), list[str]()
    for _ in range(random.choice((1, 1, 2, 3))):
        tree = _changed_tree(random, tree, raw)
    return _encoded(random, _with_raw(json.dumps(tree), raw))


def damaged_json_lines(random: Random, data: bytes) -> bytes:
    """Change entries of a file of JSON lines, their order, or its bytes."""
    if random.random() < 0.25:
        return damaged_bytes(random, data)
    lines = data.splitlines(keepends=True)
    for _ in range(random.choice((1, 1, 2))):
        at = random.randrange(len(lines))
        match random.randrange(8):
            case 0:
                del lines[at]
            case 1:
                lines.insert(random.randrange(len(lines) + 1), lines[at])
            case 2:
                random.shuffle(lines)
            case 3:
                lines[at] = random.choice(
                    (
                        b"null\n",
                        b"[]\n",
                        b"1\n",
                        b"{}\n",
                        b"\n",
                        b'{"event": []}\n',
                        b'{"event": "dwell_finished"}\n',
                        b'{"a":' * 100_000 + b"\n",
                    )
                )
            case _:
                raw: list[str] = []
                tree = _changed_tree(random, json.loads(lines[at]), raw)
                lines[at] = _with_raw(json.dumps(tree), raw).encode("utf-8", "surrogatepass") + b"\n"
        if not lines:
            break
    return b"".join(lines)


def damaged_csv(random: Random, data: bytes) -> bytes:
    """Change cells, rows or columns of a CSV file, or its bytes."""
    if random.random() < 0.15:
        return damaged_bytes(random, data)
    rows = list(csv.reader(io.StringIO(data.decode())))
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        row = random.randrange(len(rows)) if random.random() < 0.9 else 0
        column = random.randrange(max(len(rows[row]), 1))
        match random.randrange(12):
            case 0:
                del rows[row]
            case 1:
                rows.insert(random.randrange(len(rows) + 1), list(rows[row]))
            case 2:
                rows = [cells[:column] + cells[column + 1 :] for cells in rows]
            case 3:
                rows = [cells + cells[column : column + 1] for cells in rows]
            case 4:
                random.shuffle(rows)
            case 5:
                rows[row].append(random.choice(_CELLS))
            case 6 if rows[row]:
                del rows[row][column]
            case 7:
                value = random.choice(_CELLS)
                rows = rows[:1] + [
                    [value if at == column else cell for at, cell in enumerate(cells)] for cells in rows[1:]
                ]
            case 8:
                other = random.choice(rows)
                rows[row], other[:] = list(other), list(rows[row])
            case _ if rows[row]:
                rows[row][column] = random.choice(_CELLS)
        if not rows:
            break
    buffer = io.StringIO(newline="")
    csv.writer(buffer, lineterminator=random.choice(("\n", "\n", "\n", "\r\n"))).writerows(rows)
    return _encoded(random, buffer.getvalue())


_DBC_TOKENS = (
    "0", "1", "8", "9", "63", "64", "65", "1785", "99999", "4294967295", "2147483648", "-1", "1e308",
    "1e-320", "NAN",
    "M", "m0", "m0M", "m99999999", "BO_", "SG_", "SG_MUL_VAL_", "VAL_", "BA_", "SIG_VALTYPE_", "CM_",
    "EV_", ":", ";",
    "|", "@", "+", "-", "(", ")", ",", "[", "]", '"', '"x"', "x", "\\", "é",
)  # fmt: skip


def damaged_dbc(random: Random, data: bytes) -> bytes:
    """Change the tokens or lines of a DBC file, or its bytes."""
    if random.random() < 0.15:
        return damaged_bytes(random, data)
    text = data.decode()
    for _ in range(random.choice((1, 1, 1, 2, 5))):
        lines = text.split("\n")
        tokens = re.findall(r"\s+|[A-Za-z_]\w*|[-+0-9.eE]+|.", text)
        at = random.randrange(len(lines))
        token = random.randrange(len(tokens))
        match random.randrange(10):
            case 0:
                del lines[at]
                text = "\n".join(lines)
            case 1:
                lines.insert(random.randrange(len(lines) + 1), lines[at])
                text = "\n".join(lines)
            case 2:
                other = random.randrange(len(lines))
                lines[at], lines[other] = lines[other], lines[at]
                text = "\n".join(lines)
            case 3:
                nonsense = random.choice(
                    ("(" * 5000, '"' * 5001, "SG_ " * 5000, "BO_ 1 x: 8 y\n" * 3000, "NS_ :\n" * 500)
                )
                lines.insert(at, nonsense)
                text = "\n".join(lines)
            case 4:
                del tokens[token]
                text = "".join(tokens)
            case _:
                numbers = [index for index, each in enumerate(tokens) if re.fullmatch(r"-?[0-9.]+", each)]
                if numbers and random.random() < 0.6:
                    token = random.choice(numbers)
                tokens[token] = random.choice(_DBC_TOKENS)
                text = "".join(tokens)
    return _encoded(random, text)
