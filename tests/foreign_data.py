"""Measurements as other people might write them down, made by rules, in every format that is read."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
REAL = Path(os.environ.get("RIG_REAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
HEAD = """format: 1
kind: {kind}
label: made
unit: {{serial: A1}}
provenance: {{source: made for a test, licence: CC0-1.0}}
"""


def real(name: str) -> Path:
    """A file of the real data sets; the test is skipped without it."""
    path = REAL / name
    if not path.exists():
        pytest.skip(f"found no {path}: RIG_REAL_DATA names the folder of the real data sets")
    return path


def columns_text(columns: Mapping[str, str]) -> str:
    """The columns of a manifest from `name: rest`."""
    return "columns:\n" + "".join(f"- {{column: {name}, {rest}}}\n" for name, rest in columns.items())


def turning(seconds: float = 60.0, rate: float = 100.0, seed: int = 1, delay: float = 0.01) -> dict[str, Array]:
    """A case that is swung about its upright z axis; encoder in °, gyro in °/s with a delay and noise, g upright."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    angle = 60.0 * np.sin(1.1 * t) + 25.0 * np.sin(2.9 * t + 0.4)
    late = t - delay
    turn = 66.0 * np.cos(1.1 * late) + 72.5 * np.cos(2.9 * late + 0.4)
    noise = random.normal(size=(len(t), 6))
    return {
        "t_s": t, "encoder_deg": angle + 0.01 * noise[:, 0], "gyro_x_dps": 0.1 * noise[:, 1],
        "gyro_z_dps": turn + 0.2 * noise[:, 2], "acc_x_g": 0.01 * noise[:, 3], "acc_y_g": 0.01 * noise[:, 4],
        "acc_z_g": 1.0 + 0.01 * noise[:, 5],
    }  # fmt: skip


TURNING = {
    "encoder_deg": "quantity: angle, unit: °, role: reference",
    "gyro_x_dps": "quantity: rate, unit: °/s, axis: x",
    "gyro_z_dps": "quantity: rate, unit: °/s, axis: z, tolerance: 3 %",
    **{f"acc_{a}_g": f"quantity: acceleration, unit: g, axis: {a}" for a in "xyz"},
}


def turning_manifest(path: str, time: str = "{column: t_s, unit: s}", columns: Mapping[str, str] = TURNING) -> str:
    """The manifest of `turning`."""
    return (
        HEAD.format(kind="rotation")
        + f"files: [{{path: {path}}}]\ntime: {time}\nrotation: {{axis: z, upright: true}}\n"
        + columns_text(columns)
    )


def shaken(frequency: float = 5.0, seconds: float = 8.0, rate: float = 1000.0, mains: float = 60.0) -> dict[str, Array]:
    """A sweep's file: drive in V, base and board in m/s², with noise and mains lines."""
    random = np.random.default_rng(3)
    t = np.arange(round(seconds * rate)) / rate
    hum = sum(0.02 * np.sin(2.0 * math.pi * k * mains * t + k) for k in (1, 2, 4))
    tone = np.sin(2.0 * math.pi * frequency * t)
    noise = 0.003 * random.normal(size=(len(t), 2))
    return {"drive_V": 0.5 * tone, "base": 2.0 * tone + hum + noise[:, 0], "board": 1.96 * tone + hum + noise[:, 1]}


SHAKEN = {
    "board": "quantity: acceleration, unit: m/s², tolerance: 5 %",
    "base": "quantity: acceleration, unit: m/s², role: reference",
    "drive_V": "quantity: voltage, unit: V, role: drive",
}


def shaken_manifest(path: str, more: str = "", settings: str = "frequency: 5 Hz, level: low") -> str:
    """The manifest of `shaken`."""
    return (
        HEAD.format(kind="sweep")
        + f"files: [{{path: {path}, settings: {{{settings}}}}}]\ntime: {{rate: 1000 Hz}}\n{more}"
        + columns_text(SHAKEN)
    )


def tracked(seconds: float = 30.0, rate: float = 200.0) -> dict[str, Array]:
    """Free motion: a quaternion body to world, a position, gyros in rad/s and accelerometers in m/s² at rest first."""
    random = np.random.default_rng(5)
    t = np.arange(round(seconds * rate)) / rate
    moving = np.clip((t - 5.0) / 2.0, 0.0, 1.0)
    omega = np.stack([1.5 * np.sin(1.7 * t), 1.2 * np.sin(2.3 * t + 1.0), 1.9 * np.sin(1.3 * t + 2.0)], axis=1)
    omega *= moving[:, None]
    q = np.empty((len(t), 4))
    q[0] = (1.0, 0.0, 0.0, 0.0)
    for k in range(1, len(t)):
        q[k] = turned(q[k - 1], 0.5 * (omega[k - 1] + omega[k]) / rate)
    noise = random.normal(size=(len(t), 6))
    out = {"t": t, **{f"gyro_{a}": omega[:, i] + 0.002 * noise[:, i] for i, a in enumerate("xyz")}}
    up = np.stack([2 * (q[:, 1] * q[:, 3] - q[:, 0] * q[:, 2]), 2 * (q[:, 2] * q[:, 3] + q[:, 0] * q[:, 1]),
                   1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2)], axis=1)  # fmt: skip
    out |= {f"acc_{a}": 9.80665 * up[:, i] + 0.02 * noise[:, 3 + i] for i, a in enumerate("xyz")}
    out |= {f"quat_{a}": q[:, i] for i, a in enumerate("wxyz")}
    return out | {f"pos_{a}": 0.05 * np.sin(t + i) * moving for i, a in enumerate("xyz")}


def turned(q: Array, by: Array) -> Array:
    """A quaternion (scalar first) after a further turn in the body, a rotation vector in rad."""
    size = float(np.linalg.norm(by))
    w, v = math.cos(size / 2.0), by * (0.5 * np.sinc(size / 2.0 / math.pi))
    return np.array([q[0] * w - q[1:] @ v, *(q[0] * v + w * q[1:] + np.cross(q[1:], v))])


TRACKED = {
    **{f"gyro_{a}": f"quantity: rate, unit: rad/s, axis: {a}, tolerance: 3 %" for a in "xyz"},
    **{f"acc_{a}": f"quantity: acceleration, unit: m/s², axis: {a}, tolerance: 3 %" for a in "xyz"},
    **{f"quat_{a}": f"quantity: quaternion, component: {a}, role: reference" for a in "wxyz"},
    **{f"pos_{a}": f"quantity: position, unit: m, axis: {a}, role: reference" for a in "xyz"},
}


def tracked_manifest(path: str, pose: str = "body_to_world") -> str:
    """The manifest of `tracked`."""
    head = HEAD.format(kind="motion") + f"files: [{{path: {path}}}]\ntime: {{column: t, unit: s}}\n"
    return head + f"pose: {{quaternion: {pose}, up: z}}\n" + columns_text(TRACKED)


def resting(seconds: float = 20.0, rate: float = 100.0, seed: int = 4) -> dict[str, Array]:
    """A record at rest with z up, and nothing but noise."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    data = {"t_s": t, **{f"acc_{a}_g": float(a == "z") + 0.003 * random.normal(size=len(t)) for a in "xyz"}}
    return data | {f"gyro_{a}_dps": 0.05 * random.normal(size=len(t)) for a in "xyz"}


RESTING = {
    **{f"acc_{a}_g": f"quantity: acceleration, unit: g, axis: {a}" for a in "xyz"},
    **{f"gyro_{a}_dps": f"quantity: rate, unit: dps, axis: {a}" for a in "xyz"},
}


def resting_manifest(path: str, reading: str = "") -> str:
    """The manifest of `resting`."""
    head = HEAD.format(kind="static") + f"files: [{{path: {path}}}]\n{reading}time: {{column: t_s, unit: s}}\n"
    return head + columns_text(RESTING)


def responding(polarity: float = 0.0) -> dict[str, Array]:
    """A frequency-response table of a delay of 1.5 ms, repeated three times."""
    f = np.tile([10.0, 20.0, 40.0, 80.0, 160.0, 250.0], 3)
    scatter = 1.0 + 1e-3 * np.random.default_rng(2).normal(size=len(f))
    phase = np.angle(np.exp(1j * (polarity - 2.0 * math.pi * f * 1.5e-3)))
    return {"freqs": f, "mag": 1.02 * scatter, "maguncer": np.full(len(f), 1e-3), "phase": phase}


RESPONDING = {
    "freqs": "quantity: frequency, unit: Hz, role: reference",
    "mag": "quantity: magnitude, uncertainty_column: maguncer, tolerance: 5 %",
    "phase": "quantity: phase, unit: rad",
}


def responding_manifest(path: str) -> str:
    """The manifest of `responding`."""
    return HEAD.format(kind="response") + f"files: [{{path: {path}}}]\n" + columns_text(RESPONDING)


def csv_bytes(data: Mapping[str, Array], delimiter: str = ",", comma: bool = False) -> bytes:
    """A text file with a header line; seventeen digits, so that it reads back to the bit."""
    lines = [delimiter.join(data)]
    for row in zip(*data.values(), strict=True):
        cells = [repr(float(x)) for x in row]
        lines.append(delimiter.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return ("\n".join(lines) + "\n").encode()


def npz_bytes(data: Mapping[str, Array]) -> bytes:
    """Every column an array of its own."""
    file = io.BytesIO()
    np.savez(file, **dict(data))
    return file.getvalue()


def npy_bytes(data: Mapping[str, Array]) -> bytes:
    """One table."""
    file = io.BytesIO()
    np.save(file, np.column_stack(list(data.values())))
    return file.getvalue()


def mat_bytes(data: Mapping[str, Any]) -> bytes:
    """A MAT file of version 5."""
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, dict(data))
    return file.getvalue()


def hdf5_bytes(data: Mapping[str, Array]) -> bytes:
    """Datasets in a group `imu`."""
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w") as out:
        for name, values in data.items():
            out[f"imu/{name}"] = values
    return file.getvalue()
