"""How a fuzz target is run: by atheris with the options of libFuzzer, or by random changes of its seeds."""

from __future__ import annotations

import json
import tempfile
from contextlib import nullcontext
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

GOLDEN = Path(__file__).parents[1] / "link" / "golden"


def recorded_frames() -> list[bytes]:
    """One frame of every message and direction."""
    paths = sorted(GOLDEN.glob("*.json"))
    return [bytes.fromhex(json.loads(path.read_text(encoding="utf-8"))["frame"]) for path in paths]


def coverage_guided(wanted: bool) -> AbstractContextManager[Any]:
    """In this context imported modules tell atheris of their branches, where that is wanted."""
    if not wanted:
        return nullcontext()
    import atheris

    context: AbstractContextManager[Any] = atheris.instrument_imports(
        include=["edmctl.link", "edmctl.simulator"]
    )
    return context


def fuzz(target: Callable[[bytes], None], seeds: Sequence[bytes], arguments: list[str]) -> None:
    """Fuzz until libFuzzer's options say stop; without a corpus of its own it starts from the seeds."""
    import atheris

    with tempfile.TemporaryDirectory() as folder:
        for number, data in enumerate(seeds):
            (Path(folder) / f"{number:03}").write_bytes(data)
        has_corpus = any(not a.startswith("-") for a in arguments[1:])
        atheris.Setup([*arguments, *([] if has_corpus else [folder])], target)
        atheris.Fuzz()


def drive(target: Callable[[bytes], None], seeds: Sequence[bytes], count: int, seed: int) -> None:
    """Run a target on the seeds themselves and on `count` changed ones; what it raises comes out."""
    random = Random(seed)
    for data in (b"", *seeds, *(changed(random, seeds) for _ in range(count))):
        try:
            target(data)
        except Exception as error:
            error.add_note(f"input: {data.hex()}")
            raise


def changed(random: Random, seeds: Sequence[bytes]) -> bytes:
    """Some seeds in a row with a few of the changes that fuzzers make."""
    data = bytearray(b"".join(random.choice(seeds) for _ in range(random.randrange(1, 8))))
    for _ in range(random.randrange(6)):
        at = random.randrange(len(data) + 1)
        kind = random.randrange(5)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << random.randrange(8)
        elif kind == 1:
            data[at:at] = random.randbytes(random.randrange(20))
        elif kind == 2:
            del data[at : at + random.randrange(30)]
        elif kind == 3:
            data[at:at] = bytes(random.randrange(12))
        else:
            data[at:at] = data[max(0, at - random.randrange(40)) : at]
    return bytes(data)
