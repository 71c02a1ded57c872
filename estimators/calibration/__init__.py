"""Calibration: from measurements of an instrument to the samples of its declared rig."""

from __future__ import annotations

from .response import gate_from_scan, pulse_from_trace, simulate_measurement

__all__ = ["gate_from_scan", "pulse_from_trace", "simulate_measurement"]
