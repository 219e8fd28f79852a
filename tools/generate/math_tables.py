"""firmware/math/tables.h: powers of two and logarithms, as a double and what it lacks of the exact value."""

from __future__ import annotations

from decimal import Decimal, getcontext

EXP_STEPS, LOG_STEPS = 64, 128
_HEAD = """\
/* Made by `python -m tools.generate` (tools/generate/math_tables.py). */
#ifndef EDM_MATH_TABLES_H
#define EDM_MATH_TABLES_H

"""


def header() -> str:
    """Return the source."""
    getcontext().prec = 60
    ln2 = Decimal(2).ln()
    powers = [(Decimal(k) / EXP_STEPS * ln2).exp() for k in range(EXP_STEPS)]
    # A reciprocal of nine bits for each step of a mantissa in [1, 2): its product with 26 bits is exact.
    inverses = [round(512 / (1 + (k + 0.5) / LOG_STEPS)) / 512 for k in range(LOG_STEPS)]
    logs = [-Decimal(inverse).ln() for inverse in inverses]
    return (
        f"{_HEAD}#define EXP_STEPS {EXP_STEPS}\n#define LOG_STEPS {LOG_STEPS}\n\n"
        f"/* 2^(k/{EXP_STEPS}) */\n{_pairs('POWERS', powers)}\n"
        f"/* 1/c of nine bits and log(c) near the middle of each step of a mantissa */\n"
        f"static const double INVERSES[] = {{\n{_lines([inverse.hex() for inverse in inverses])}}};\n"
        f"{_pairs('LOGS', logs)}\n#endif\n"
    )


def _pairs(name: str, values: list[Decimal]) -> str:
    pairs = [(float(value), float(value - Decimal(float(value)))) for value in values]
    return f"static const double {name}[][2] = {{\n{_lines([f'{{{a.hex()}, {b.hex()}}}' for a, b in pairs])}}};\n"


def _lines(items: list[str]) -> str:
    return "".join(f"    {', '.join(items[k : k + 2])},\n" for k in range(0, len(items), 2))
