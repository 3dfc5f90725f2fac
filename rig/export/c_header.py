"""A C99 header that applies a repaired model on a microcontroller: no allocation, no state but what the caller holds.

#include "sim_cube_1_correction.h"
sim_cube_1_apply(volts, temperature, supply, time, out);
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from rig.correction.correction import Correction
from rig.correction.coupling import CONDITIONS, UNSETTLED, Written
from rig.correction.expression import in_c
from rig.correction.inverse import Drift
from rig.export.correction_numbers import (
    Numbers,
    filtered,
    half,
    heading,
    numbers_of,
    rows_apart,
    stays,
    stem,
    words_of,
)
from rig.export.identifiers import identifiers

PER_LINE = 6
SPELLED = {
    "²": "^2", "³": "^3", "·": " ", "×": "x", "±": "+/-", "°": "deg ", "µ": "u", "√": "sqrt ", "−": "-",
}  # fmt: skip
RESERVED = ("CHANNELS", "RATE", "LATENCY", "CORRECTION_H")  # what the header itself defines


class _Writer:
    """Words that depend on the name before everything (`p`) and on the precision."""

    def __init__(self, prefix: str, single: bool) -> None:
        self.p, self.caps, self.single = prefix, prefix.upper(), single
        self.real = f"{prefix}_real"
        self.f = "f" if single else ""

    def number(self, value: float) -> str:
        """A plain constant."""
        if math.isinf(value):
            return "INFINITY" if value > 0.0 else "-INFINITY"
        return f"{value!r}{self.f}"

    def numbers(self, values: Sequence[float]) -> str:
        """Constants of an array, some on every line."""
        words = [self.number(value) for value in values]
        lines = [", ".join(words[k : k + PER_LINE]) for k in range(0, len(words), PER_LINE)]
        return ",\n    ".join(lines)


def files(correction: Correction, rate: float | None = None, single: bool = False) -> dict[str, bytes]:
    """The header by its file name; `single`: floats instead of doubles. Raises BadInput for a model of no channel."""
    channels = numbers_of(correction, rate)
    write, names = _Writer(stem(correction), single), identifiers([one.name for one in channels], RESERVED)
    parts = [
        *_comment([*_about(correction, rate, single), "", *(words_of(one) for one in channels)]),
        *_comment(["What stays in the numbers:", *(f"- {one}" for one in stays(correction, rate))]),
        f"#ifndef {write.caps}_CORRECTION_H",
        f"#define {write.caps}_CORRECTION_H",
        "",
        "#include <math.h>",
        "",
        f"typedef {'float' if single else 'double'} {write.real};",
        "",
        *_channels(write, channels, names),
        *_input(write, channels),
        *_root(write),
        *_sign(write, correction),
        *_separate(write, correction, channels),
        *_apply(write),
        *_filter(write, channels, rate),
        f"#endif /* {write.caps}_CORRECTION_H */",
        "",
    ]
    return {f"{write.p}_correction.h": "\n".join(parts).encode("ascii")}


def _about(correction: Correction, rate: float | None, single: bool) -> Iterator[str]:
    yield f"Correction of {correction.unit}: volts in, m/s^2 along and rad/s about the axes of the case out."
    yield from heading(correction)
    yield f"C99, {'float' if single else 'double'}. No allocation; constants are SI and volts."
    known = f"{rate:g} samples per second" if rate is not None else "no rate: filters and delays stay"
    yield f"Made for {known}."


def _comment(lines: Sequence[str]) -> list[str]:
    """Text that cannot leave its comment, in ASCII."""
    return ["/*", *(f" * {_ascii(line)}".rstrip() for line in lines), " */", ""]


def _ascii(line: str) -> str:
    spelled = "".join(SPELLED.get(c, c) for c in line)
    return spelled.encode("ascii", "backslashreplace").decode().replace("*/", "* /").replace("/*", "/ *")


def _channels(write: _Writer, channels: Sequence[Numbers], names: Mapping[str, str]) -> Iterator[str]:
    yield "/* Places of the channels in every array. */"
    yield "enum {"
    for number, one in enumerate(channels):
        yield f"    {write.caps}_{names[one.name].upper()} = {number}, /* {_ascii(one.name)}, {_ascii(one.unit)} */"
    yield f"    {write.caps}_CHANNELS = {len(channels)}"
    yield "};"
    yield ""
    yield "/* How late slow signals of a channel are, s, where its filters are not undone. */"
    yield f"static const {write.real} {write.p}_lag[{len(channels)}] = {{"
    yield f"    {write.numbers([one.lag for one in channels])}"
    yield "};"
    yield ""


def _input(write: _Writer, channels: Sequence[Numbers]) -> Iterator[str]:
    yield "/* What drives each output: less zero, by sensitivity, both as they are under these conditions. */"
    r = write.real
    yield f"static inline void {write.p}_input(const {r} volts[{len(channels)}], {r} temperature, {r} supply, {r} time,"
    yield f"                                   {r} out[{len(channels)}])"
    yield "{"
    yield f"    {r} zero, gain, phi;"
    yield "    (void)temperature; (void)supply; (void)time; (void)phi;"
    for number, one in enumerate(channels):
        s = write.number(one.sensitivity)
        yield f"    zero = {write.number(one.zero)}; gain = {write.number(1.0)}; /* {_ascii(one.name)} */"
        for drift in one.drifts:
            yield f"    phi = {_phi(write, drift)};"
            more = f" + {s} * {write.number(drift.shift)} * phi" if drift.shift else ""
            by = f" * ({write.number(1.0)} + {write.number(drift.zero)} * phi)" if drift.zero else ""
            yield f"    zero = zero{by}{more};"
            if drift.gain:
                yield f"    gain = gain * ({write.number(1.0)} + {write.number(drift.gain)} * phi);"
        yield f"    out[{number}] = (volts[{number}] - zero) / ({s} * gain);"
    yield "}"
    yield ""


def _phi(write: _Writer, drift: Drift) -> str:
    if not drift.of:
        return write.number(1.0)
    if drift.decay:
        return f"exp{write.f}(-{drift.of} / {write.number(drift.decay)})"
    return f"{drift.of} - {write.number(drift.reference)}"


def _root(write: _Writer) -> list[str]:
    """The same steps as `rig.export.corrected._root`."""
    r, n, epsilon = write.real, write.number, "1.1920929e-07f" if write.single else "2.220446049250313e-16"
    return [
        "/* x of w = first x + second x^2 + third x^3, x >= 0, by Newton's rule between bounds; NAN beyond top. */",
        f"static inline {r} {write.p}_root({r} w, {r} first, {r} second, {r} third, {r} top, {r} least)",
        "{",
        f"    {r} low = {n(0.0)}, high = isinf(top) ? w / least : top, x, off, slope, next;",
        "    int step, done;",
        f"    if (!isfinite(w) || !(top > {n(0.0)})) return NAN;",
        "    if (!isinf(top) && w > top * (first + top * (second + top * third))) return NAN;",
        f"    x = fmin{write.f}(w / first, high);",
        "    for (step = 0; step < 80; ++step) {",
        "        off = x * (first + x * (second + x * third)) - w;",
        f"        if (off <= {n(0.0)}) low = x;",
        f"        if (off >= {n(0.0)}) high = x;",
        f"        slope = first + x * ({n(2.0)} * second + {n(3.0)} * x * third);",
        f"        next = slope != {n(0.0)} ? x - off / slope : NAN;",
        f"        if (!(low <= next && next <= high)) next = {n(0.5)} * (low + high);",
        f"        done = fabs{write.f}(next - x) <= {epsilon} * fabs{write.f}(next);",
        "        x = next;",
        "        if (done) break;",
        "    }",
        "    return x;",
        "}",
        "",
    ]


def _sign(write: _Writer, correction: Correction) -> list[str]:
    if not any("sign" in str(one.expression) for one in correction.coupling.written):
        return []
    return [f"static inline double {write.p}_sign(double x) {{ return (x > 0.0) - (x < 0.0); }}", ""]


def _separate(write: _Writer, correction: Correction, channels: Sequence[Numbers]) -> Iterator[str]:
    r, count = write.real, len(channels)
    yield "/* What each axis went through, of what each channel felt. rise: derivatives of out, per second, where the"
    yield " * caller knows them (angular acceleration), else 0 in place of the array: what they add then stays. */"
    yield f"static inline void {write.p}_separate(const {r} felt[{count}], const {r} rise[{count}], {r} temperature,"
    yield f"                                      {r} supply, {r} time, {r} out[{count}])"
    yield "{"
    yield f"    {r} seen[{count}], left[{count}]{f', before[{count}]' if correction.coupling.written else ''};"
    yield f"    int n, pass = {correction.coupling.passes};"
    yield "    (void)rise; (void)temperature; (void)supply; (void)time;"
    yield f"    for (n = 0; n < {count}; ++n) seen[n] = felt[n];"
    for number, one in enumerate(channels):
        for bend in reversed(one.bends):
            at, shift = f"seen[{number}]", write.number(bend.shift)
            above, below = (", ".join(write.number(v) for v in half(side)) for side in bend.halves)
            yield f"    {at} -= {shift};"
            yield f"    {at} = {at} >= {write.number(0.0)} ? {write.p}_root({at}, {above})"
            yield f"        : -{write.p}_root(-{at}, {below});"
    yield f"    for (n = 0; n < {count}; ++n) left[n] = seen[n];"
    yield "    for (;;) {"
    for number, row in enumerate(rows_apart(correction)):
        terms = " + ".join(f"{write.number(share)} * left[{k}]" for k, share in row)
        yield f"        out[{number}] = {terms};"
    if correction.coupling.written:
        yield f"        if (pass <= 0) for (n = 0; n < {count}; ++n) if (!(fabs(out[n] - before[n])"
        yield f"            <= {UNSETTLED!r} * (1.0 + fabs(out[n])))) out[n] = NAN;"
    yield "        if (pass-- <= 0) break;"
    if correction.coupling.written:
        yield f"        for (n = 0; n < {count}; ++n) before[n] = out[n];"
    yield f"        for (n = 0; n < {count}; ++n) left[n] = seen[n];"
    for felt in correction.coupling.felt:
        share, into = write.number(felt.share), f"left[{felt.channel}]"
        if felt.second is None:
            yield f"        if (rise) {into} -= {share} * rise[{felt.first}];"
        else:
            yield f"        {into} -= {share} * out[{felt.first}] * out[{felt.second}];"
    for written in correction.coupling.written:
        more = in_c(written.expression, _signals(write, written))
        yield f"        left[{written.channel}] -= ({r})({more});"
    yield "    }"
    yield "}"
    yield ""


def _signals(write: _Writer, one: Written) -> Callable[[str], str]:
    """Words of C for the signals of a formula."""

    def words(name: str) -> str:
        if name in one.sources:
            return f"out[{one.sources[name]}]"
        return f"{write.p}_sign" if name == "sign" else CONDITIONS[name]

    return words


def _apply(write: _Writer) -> list[str]:
    r, count = write.real, f"{write.caps}_CHANNELS"
    return [
        "/* One sample of every channel: volts, deg C, V, s since the first record began; out in SI. */",
        f"static inline void {write.p}_apply(const {r} volts[{count}], {r} temperature, {r} supply, {r} time,",
        f"                                   {r} out[{count}])",
        "{",
        f"    {r} felt[{count}];",
        f"    {write.p}_input(volts, temperature, supply, time, felt);",
        f"    {write.p}_separate(felt, 0, temperature, supply, time, out);",
        "}",
        "",
    ]


def _filter(write: _Writer, channels: Sequence[Numbers], rate: float | None) -> list[str]:
    """Sample by sample the sums that undo filters: what comes out belongs to LATENCY samples before."""
    if rate is None or not filtered(channels):
        return []
    latency = max(0, *(one.ahead + len(one.taps) // 2 for one in channels))
    length = latency - min(0, *(one.ahead - len(one.taps) // 2 for one in channels)) + 1
    wide = len(channels) + 3
    return [
        f"#define {write.caps}_RATE {write.number(float(rate))} /* samples per second */",
        f"#define {write.caps}_LATENCY {latency} /* samples: what {write.p}_step gives belongs to so many before */",
        "",
        *_taps(write, channels),
        "/* The last samples, and temperature, supply and time with them; all zero to begin with. */",
        f"typedef struct {{ {write.real} past[{length}][{wide}]; int newest; int begun; }} {write.p}_filter;",
        "",
        *_sum(write, length),
        *_step(write, channels, latency, length),
    ]


def _taps(write: _Writer, channels: Sequence[Numbers]) -> Iterator[str]:
    for number, one in enumerate(channels):
        yield f"static const {write.real} {write.p}_taps_{number}[{len(one.taps)}] = {{ /* {_ascii(one.name)} */"
        yield f"    {write.numbers(one.taps)}"
        yield "};"
    yield ""


def _sum(write: _Writer, length: int) -> list[str]:
    r = write.real
    return [
        f"static inline {r} {write.p}_sum(const {write.p}_filter *filter, int channel, const {r} *taps, int count,",
        "                                 int back)",
        "{",
        f"    {r} sum = {write.number(0.0)};",
        "    int k;",
        "    for (k = 0; k < count; ++k)",
        f"        sum += taps[k] * filter->past[(filter->newest - back + k + 2 * {length}) % {length}][channel];",
        "    return sum;",
        "}",
        "",
    ]


def _step(write: _Writer, channels: Sequence[Numbers], latency: int, length: int) -> Iterator[str]:
    r, count = write.real, len(channels)
    yield f"/* One more sample of every channel, evenly at {write.caps}_RATE; filters, delays and scale undone. */"
    yield f"static inline void {write.p}_step({write.p}_filter *filter, const {r} volts[{count}], {r} temperature,"
    yield f"                                  {r} supply, {r} time, {r} out[{count}])"
    yield "{"
    yield f"    {r} felt[{count}], *now;"
    yield "    int n, k;"
    yield f"    {write.p}_input(volts, temperature, supply, time, felt);"
    yield f"    filter->newest = (filter->newest + 1) % {length};"
    yield "    now = filter->past[filter->newest];"
    yield f"    for (n = 0; n < {count}; ++n) now[n] = felt[n];"
    yield f"    now[{count}] = temperature; now[{count + 1}] = supply; now[{count + 2}] = time;"
    yield "    if (!filter->begun) {"
    yield f"        for (k = 0; k < {length}; ++k) for (n = 0; n < {count + 3}; ++n) filter->past[k][n] = now[n];"
    yield "        filter->begun = 1;"
    yield "    }"
    for number, one in enumerate(channels):
        back = latency - one.ahead + len(one.taps) // 2
        yield f"    felt[{number}] = {write.p}_sum(filter, {number}, {write.p}_taps_{number}, {len(one.taps)}, {back});"
    yield f"    now = filter->past[(filter->newest - {latency} + {length}) % {length}];"
    yield f"    {write.p}_separate(felt, 0, now[{count}], now[{count + 1}], now[{count + 2}], out);"
    yield "}"
    yield ""
