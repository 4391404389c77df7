"""Cuts and machines with checked reference numbers, shared by the tests of `stability`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
import xarray as xr

from process.cut.engagement import Engagement, engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel


@dataclass(frozen=True)
class Case:
    """A machine and a cut: `case.limits(compliance, speeds)` and friends take ``*case.cut``."""

    machine: ModalModel
    tool: Tool
    arc: Engagement
    coefficients: CuttingCoefficients

    @property
    def cut(self) -> tuple[Tool, Engagement, CuttingCoefficients]:
        return self.tool, self.arc, self.coefficients

    def compliance(self, low: float, high: float, step: float) -> xr.Dataset:
        return self.machine.compliance(np.arange(low, high, step))


@pytest.fixture(scope="session")
def textbook() -> Case:
    """Two-axis tool of a textbook, half-immersion down-milling (checked reference)."""
    machine = ModalModel(
        [456.780432, 1448.889140, 516.518148, 1408.448141],
        [0.1117054, 0.01703701, 0.02457963, 0.03135760],
        [7933097.18, 14691778.44, 9374613.81, 12406389.71],
        [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]],
    )
    arc = engagement("down", 31.75e-3 / 2, 31.75e-3)
    return Case(machine, Tool(31.75e-3, 2), arc, CuttingCoefficients(1319.4e6, 788.8e6, 0.0))


def lab_machine() -> ModalModel:
    """Flexure of the laboratory bench: m 11.3 kg, k 1.68 N/um, c 104 N s/m, in x (paper)."""
    m, k, c = 11.3, 1.68e6, 104.0
    return ModalModel([math.sqrt(k / m) / (2 * math.pi)], [c / (2 * math.sqrt(k * m))], [k], [[1, 0, 0]])


@pytest.fixture(scope="session")
def lab_slot() -> Case:
    """Laboratory bench, idle: full immersion, 50.8 mm, 4 straight inserts, Al 6061 (paper)."""
    arc = engagement("down", 50.8e-3, 50.8e-3)
    return Case(lab_machine(), Tool(50.8e-3, 4), arc, CuttingCoefficients(780e6, 351e6, 0.0))


def benchmark_case(directions: int, immersion: float) -> Case:
    """The classical benchmark: 922 Hz, 2 teeth, one or two degrees of freedom (checked reference)."""
    stiffness = 0.03993 * (2 * math.pi * 922.0) ** 2
    vectors = np.eye(3)[:directions]
    ones = np.ones(directions)
    machine = ModalModel(922.0 * ones, 0.011 * ones, stiffness * ones, vectors)
    tool = Tool(10e-3, 2)
    return Case(machine, tool, engagement("down", immersion * 10e-3, 10e-3), CuttingCoefficients(6e8, 2e8, 0.0))


def authors_case(cut: str = "down", width: float = 40e-3) -> Case:
    """The authors' own published set-up: 80 mm, 2 inserts at 45 deg, three modes with cross terms."""
    machine = ModalModel(
        [33.37, 57.44, 58.61],
        [0.061, 0.0822, 0.0287],
        [45.5e6, 32.1e6, 36.7e6],
        [[-0.055, 0.6245, 0.7724], [0.0199, 0.9968, -0.0161], [0.999, 4.0028e-4, 0.0096]],
    )
    coefficients = CuttingCoefficients(1889.2e6, 806.1e6, 291.0e6)
    return Case(machine, Tool(80e-3, 2, math.pi / 4), engagement(cut, width, 80e-3), coefficients)


def ram_case(cut: str = "down", width: float = 62.5e-3) -> Case:
    """A ram-like machine with lightly damped, fully coupled modes; 125 mm, 8 inserts, 45 deg (ours)."""
    machine = ModalModel(
        [24.0, 29.0, 34.0, 58.0, 95.0],
        [0.022, 0.026, 0.03, 0.03, 0.04],
        [40e6, 60e6, 35e6, 80e6, 90e6],
        [[0.1, 0.8, 0.6], [0.7, 0.7, 0.1], [1, 0.1, 0.05], [0.1, 0.3, 1], [0.5, -0.8, 0.2]],
    )
    coefficients = CuttingCoefficients(1889.2e6, 806.1e6, 291.0e6)
    return Case(machine, Tool(125e-3, 8, math.pi / 4), engagement(cut, width, 125e-3), coefficients)


@pytest.fixture(scope="session")
def authors() -> Case:
    return authors_case()


@pytest.fixture(scope="session")
def make_case():
    """Builders by name, for tests that vary the cut."""
    return {"authors": authors_case, "ram": ram_case, "benchmark": benchmark_case}
