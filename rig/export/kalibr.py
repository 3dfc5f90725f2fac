"""Kalibr's imu.yaml: the noise of one accelerometer unit and one set of gyros, as Kalibr's optimiser weighs them.

Keys and units as in Kalibr's "YAML formats" and "IMU Noise Model": densities (m/s²)/√Hz and (rad/s)/√Hz, σ(τ) = N/√τ;
random walks (m/s³)/√Hz and (rad/s²)/√Hz, σ(τ) = K·√(τ/3), which is the same unit as (m/s²)·√Hz. Both are two-sided,
as in the Allan convention (IEEE Std 952, annex C), so nothing is converted. Kalibr knows one number for three axes:
the worst axis is written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from rig.calibrate.calibration import Calibration, Result
from rig.errors import BadInput
from rig.export.selection import Choice, one_line, provenance, stated, value_of, whole, worst, yaml_float
from rig.sensor import Triad

# key in the file: (measurand, unit in the file, is it the accelerometers')
KEYS: Mapping[str, tuple[str, str, bool]] = {
    "accelerometer_noise_density": ("noise_density", "(m/s^2)/sqrt(Hz)", True),
    "accelerometer_random_walk": ("random_walk", "(m/s^3)/sqrt(Hz)", True),
    "gyroscope_noise_density": ("noise_density", "(rad/s)/sqrt(Hz)", False),
    "gyroscope_random_walk": ("random_walk", "(rad/s^2)/sqrt(Hz)", False),
}


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """The file by suffix; raises BadInput if a noise figure or the rate is missing and none was assumed."""
    _check(choice)
    accelerometers = whole(calibration, choice.unit, "acceleration")
    gyros = whole(calibration, choice.gyros, "rate")
    lines = [f"# {line}" for line in _header(calibration, accelerometers, gyros)]
    for key, (_, _, linear) in KEYS.items():
        lines += ["", *_entry(calibration, choice, key, (accelerometers if linear else gyros).names)]
    lines += ["", f"rostopic: {json.dumps(choice.topic)}", f"update_rate: {yaml_float(choice.rate or 0.0)}  # Hz", ""]
    return {".imu.yaml": "\n".join(lines).encode()}


def _check(choice: Choice) -> None:
    if choice.rate is None:
        raise BadInput("export to kalibr: found no rate, wanted the rate of the IMU's messages in Hz (update_rate)")
    if not choice.topic.startswith("/") or one_line(choice.topic) != choice.topic or " " in choice.topic:
        raise BadInput(f"export to kalibr: found the topic {choice.topic!r}, wanted a ROS topic such as /imu0")
    for name in choice.assumed:
        if name not in KEYS:
            raise BadInput(f"export to kalibr: found '{name}' assumed, wanted one of {', '.join(KEYS)}")


def _header(calibration: Calibration, accelerometers: Triad, gyros: Triad) -> list[str]:
    return [
        *provenance(calibration),
        f"Accelerometers: {accelerometers.name}. Gyroscopes: {gyros.name}. Each value is the worst axis of the three.",
        "Kalibr takes the noise for white up to half of update_rate; the sensors' output filters cut it off earlier.",
    ]


def _entry(calibration: Calibration, choice: Choice, key: str, channels: Sequence[str]) -> list[str]:
    measurand, unit, _ = KEYS[key]
    if key in choice.assumed:
        return _assumed(calibration, channels, key, choice.assumed[key])
    found = _determined(calibration, channels, key)
    value = value_of(calibration, found.channel, measurand)
    if value <= 0.0:
        raise BadInput(f"export to kalibr: found {found.key} = {value}, wanted more than 0")
    return [f"# {stated(found)}, worst axis", f"{key}: {yaml_float(value)}  # {unit}"]


def _determined(calibration: Calibration, channels: Sequence[str], key: str) -> Result:
    try:
        return worst(calibration, channels, KEYS[key][0])
    except BadInput as error:
        raise BadInput(f"{error}, or an assumed {key}") from None


def _assumed(calibration: Calibration, channels: Sequence[str], key: str, value: float) -> list[str]:
    measurand, unit, _ = KEYS[key]
    if all(calibration.find(f"{channel}.{measurand}") for channel in channels):
        raise BadInput(f"export to kalibr: found {key} assumed although it was determined, wanted no assumption")
    return [
        f"# ASSUMED by the person who exported this file: {measurand} of {channels[0]} and its axes was not determined",
        f"{key}: {yaml_float(value)}  # {unit}, ASSUMED",
    ]
