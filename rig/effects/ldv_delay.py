"""Delay of the vibrometer's decoder: the reference is late, so sensors seem to lead."""

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Parameter, Values


class LdvDelay(Effect):
    stage = "reference"
    instrument = "vibrometer"
    title = "delay of the vibrometer's decoder"
    equation = "a = a_shown·exp(+j·2π·f·time)"
    places = ("shaker",)
    coordinates = (Coordinate("time", 5e-6),)
    parameters = (Parameter("time", "s", (0.0, math.inf), (5e-6, 6e-5)),)
    missing = "the phases of all channels lead exactly ∝ f, by the same time, while the gains are right"
    confused_with = ("delay", "channel_skew", "ldv_low_pass")
    separate_by = "a second vibrometer or decoder on the same spot: their difference is free of the sensor"
    source = "error sources L04, U8"
    elsewhere = "it belongs to the vibrometer"

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        return np.asarray(along * np.exp(2j * math.pi * frequency * at["time"]))
