"""Calibrate a MEMS inertial unit traceably on a hardware-in-the-loop bench, and explain the sensor."""

__version__ = "0.1.0"
