"""ROS 2 parameters: per axis the scale, bias and noise of one accelerometer unit and one set of gyros.

    ros2 run <package> <node> --ros-args --params-file <name>.ros2.yaml

Parameters hold one of ROS 2's types each: a flag, a float, a text, or a list of floats in the order x, y, z; matrices
are row by row. motion = M⁻¹ · (volts − bias) / scale, with M the misalignment. The covariances are those of
sensor_msgs/msg/Imu: the variance of the noise at rest on the diagonal, −1 first where nothing is measured. Imported
records at rest alone give the covariances and no scale; scales of imported records are ratios, and take the numbers
of the files in SI in place of volts.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

from rig.calibrate.calibration import Calibration
from rig.errors import BadInput
from rig.export.selection import (
    Choice,
    cross_axis,
    imported,
    needed,
    provenance,
    stated,
    value_of,
    whole,
    yaml_float,
)
from rig.sensor import Quantity, Triad

MESSAGES: Mapping[Quantity, str] = {"acceleration": "linear_acceleration", "rate": "angular_velocity"}
NOISE: Mapping[str, str] = {
    "noise_density": "per sqrt(Hz), two-sided root", "bias_instability": "", "random_walk": "times sqrt(Hz)",
}  # fmt: skip
UNKNOWN = [-1.0] + [0.0] * 8  # sensor_msgs/msg/Imu: element 0 is -1 where there is no estimate
BODY_FROM_CUBE = [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0]

FRAME = (
    "Frame: the cube's, x forward, y up (against gravity as it stands on the shaker table), z to the right.",
    "Right-handed. Accelerometers give specific force: at rest with y up, y reads +9.8 m/s^2.",
    "Gyro axes: roll about x, yaw about y, pitch about z, right-hand rule. Every list is in the order x, y, z.",
    "REP 103 (x forward, y left, z up) is body_from_cube times a vector of this file; matrices are row by row.",
    "motion = inverse(misalignment) * (volts - bias) / scale, in m/s^2 and rad/s.",
)
OWN_FRAME = (
    "Frame: the device's own, as its manifest names the axes. Every list is in the order x, y, z.",
    "motion = inverse(misalignment) * (number - bias) / scale, with the file's numbers in m/s^2 and rad/s.",
)


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """The file by suffix; raises BadInput if an axis of a measured triad lacks scale, bias or noise."""
    triads = [triad for triad in (choice.unit, choice.gyros) if triad is not None]
    if not any(_measured(calibration, triad) or _noisy(calibration, triad) for triad in triads):
        names = " or ".join(triad.name for triad in triads) or "any unit"
        raise BadInput(f"calibration {calibration.name}: found no sensitivity of {names}, wanted one of them")
    frame = OWN_FRAME if imported(calibration) else FRAME
    comments = [f"# {line}" for line in (*provenance(calibration), *frame)]
    body = [f"    {line}" for line in _parameters(calibration, choice)]
    return {".ros2.yaml": "\n".join([*comments, "/**:", "  ros__parameters:", *body, ""]).encode()}


def _measured(calibration: Calibration, triad: Triad) -> bool:
    return any(calibration.to_use(channel, "sensitivity") for channel in triad.names)


def _noisy(calibration: Calibration, triad: Triad) -> bool:
    """Whether there is noise in SI without a sensitivity of the triad's own: imported numbers are in SI as stated."""
    return imported(calibration) and any(calibration.find(f"{channel}.deviation") for channel in triad.names)


def _parameters(calibration: Calibration, choice: Choice) -> Iterator[str]:
    yield f"frame_id: {json.dumps('imu' if imported(calibration) else 'sensor_cube')}"
    yield f"calibration: {json.dumps(calibration.name)}"
    yield f"serial: {json.dumps(calibration.serial)}"
    yield f"simulated: {'true' if calibration.simulated else 'false'}"
    if not imported(calibration):
        yield f"body_from_cube: {_list(BODY_FROM_CUBE)}"
    yield f"orientation_covariance: {_list(UNKNOWN)}  # no orientation is measured"
    yield from _triad(calibration, "acceleration", choice.unit)
    yield from _triad(calibration, "rate", choice.gyros)


def _triad(calibration: Calibration, quantity: Quantity, triad: Triad | None) -> Iterator[str]:
    name = MESSAGES[quantity]
    if triad is None or not (_measured(calibration, triad) or _noisy(calibration, triad)):
        said = "there is none" if triad is None else f"{triad.name} was not calibrated"
        yield f"{name}_covariance: {_list(UNKNOWN)}  # {said}"
        return
    whole(calibration, triad, quantity)
    noise = [value_of(calibration, channel, "deviation") for channel in triad.names]
    yield f"{name}_covariance: {_list(_diagonal([u * u for u in noise]))}"
    yield f"{name}:"
    yield f"  channels: [{', '.join(json.dumps(channel) for channel in triad.names)}]"
    yield from (f"  {line}" for line in _noise(calibration, triad))
    if _measured(calibration, triad):
        yield from (f"  {line}" for line in _numbers(calibration, triad))


def _noise(calibration: Calibration, triad: Triad) -> Iterator[str]:
    """Coefficients that were determined of all three axes, SI."""
    for measurand, what in NOISE.items():
        found = [calibration.find(f"{channel}.{measurand}") for channel in triad.names]
        known = [result for result in found if result is not None]
        if len(known) == len(triad.names):
            yield from (f"# {stated(result)}" for result in known)
            si = "m/s^2" if triad.quantity == "acceleration" else "rad/s"
            yield f"{measurand}: {_list([float(result.value or 0.0) for result in known])}  # {f'{si} {what}'.strip()}"


def _numbers(calibration: Calibration, triad: Triad) -> Iterator[str]:
    channels = triad.names
    for parameter, measurand in (("scale", "sensitivity"), ("bias", "offset")):
        found = [needed(calibration, channel, measurand) for channel in channels]
        its_unit = found[0].unit.replace("²", "^2")
        yield from (f"# {stated(result)}" for result in found)
        yield f"{parameter}: {_list([value_of(calibration, c, measurand) for c in channels])}  # {its_unit}"
        yield f"{parameter}_expanded_uncertainty: {_list([result.expanded for result in found])}  # {its_unit}"
    matrix = cross_axis(calibration, triad)
    yield f"misalignment_determined: {'true' if matrix else 'false'}"
    if matrix:
        yield f"misalignment: {_list([value for row in matrix for value in row])}"


def _diagonal(values: Sequence[float]) -> list[float]:
    """A diagonal matrix of three values, row by row."""
    return [values[row] if row == column else 0.0 for row in range(3) for column in range(3)]


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(yaml_float(value) for value in values)}]"
