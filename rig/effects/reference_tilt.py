"""The reference's frame is turned against the case: markers or a shaft are not along the axes of the sensor."""

import math

import numpy as np

from rig.model import Array, Coordinate, Effect, Motion, Parameter, Values


class ReferenceTilt(Effect):
    stage = "reference"
    title = "reference's frame turned against the case"
    equation = "u = R(x, y, z)·u_shown, the same rotation for rates and forces; in a rotation only across its axis"
    places = ("rotation", "free")
    coordinates = (Coordinate("x", 1e-3), Coordinate("y", 1e-3), Coordinate("z", 1e-3))
    parameters = tuple(Parameter(axis, "rad", (-math.pi, math.pi), (0.0, 0.1)) for axis in "xyz")
    missing = "every axis shows shares of the others, of rates and accelerations alike, with opposite signs"
    confused_with = ("cross_axis", "non_orthogonality")
    separate_by = "the case's own edges as reference, or gravity in known poses; shares that differ are the sensor's"
    source = "error sources T08; IEEE 1293 (misalignment of mounting)"
    elsewhere = "it belongs to the reference"

    def motion(self, motion: Motion, at: Values) -> Motion:
        vector = np.array([at["x"], at["y"], at["z"]])
        turns = np.any(motion.rate != 0.0, axis=-1)
        if np.count_nonzero(turns) == 1:  # about the only axis it is the angle at which the encoder counts zero
            vector[turns] = 0.0
        turn = _rotation(vector)
        moved = {name: _turned(turn, getattr(motion, name)) for name in ("force", "rate", "turning", "up")}
        return Motion(**{**vars(motion), **moved})


def _turned(turn: Array, vector: Array) -> Array:
    return np.asarray(np.tensordot(turn, vector, axes=1))


def _rotation(vector: Array) -> Array:
    """Rotation by |vector| about it (Rodrigues), (3, 3)."""
    x, y, z = vector
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = np.sinc(angle / (2.0 * math.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / math.pi) * cross + 0.5 * half**2 * cross @ cross)
