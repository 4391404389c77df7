"""Masses attached only to measure: taken off a compliance exactly, with its errors, as far as the axes are known."""

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance
from smfe.identification.errors.attached_mass import without_mass
from smfe.identification.errors.intervals import interval

F = np.arange(20.0, 200.0, 1.0)
# A machine of three coordinates, all coupled: matrices, nothing modal.
MASS = np.diag([20.0, 30.0, 25.0])
STIFFNESS = np.array([[6.0, -2.0, -1.0], [-2.0, 9.0, -2.0], [-1.0, -2.0, 8.0]]) * 1e6
DAMPING = 2e-4 * STIFFNESS + 5.0 * MASS


def machine(added: float = 0.0, axes: str = "xyz") -> np.ndarray:
    """Compliance (f, 3, 3) by inverting the dynamic stiffness; the added mass moves along `axes`."""
    extra = added * np.diag([float(a in axes) for a in "xyz"])
    w = 2.0 * np.pi * F[:, None, None]
    return np.linalg.inv(STIFFNESS + 1j * w * DAMPING - w**2 * (MASS + extra))


def labelled(values: np.ndarray, rows: str = "xyz", columns: str = "xyz", std: float | None = None) -> xr.Dataset:
    part = values[:, ["xyz".index(a) for a in rows]][:, :, ["xyz".index(a) for a in columns]]
    dims = ("frequency", "response", "excitation")
    extra = {} if std is None else {"compliance_std": (dims, np.full(part.shape, std))}
    return make_compliance(F, part, list(rows), list(columns), extra)


def test_the_mass_is_taken_off_the_whole_matrix_exactly() -> None:
    found, notes = without_mass(labelled(machine(3.0)), 3.0)
    assert found["compliance"].values == pytest.approx(machine(), rel=1e-9)
    assert "the mass of 3 kg was taken off; that changed the compliance by up to" in notes[0]
    assert found.attrs["attached_mass_kg"] == 3.0


def test_one_direction_is_the_formula_of_the_books() -> None:
    """H = H'/(1 + w^2 m H'_dd), exact where the mass moves along the force only."""
    loaded = machine(3.0, "x")
    found, notes = without_mass(labelled(loaded, "xy", "x"), 3.0)
    by_hand = loaded[:, :2, :1] / (1.0 + 3.0 * (2.0 * np.pi * F[:, None, None]) ** 2 * loaded[:, :1, :1])
    assert found["compliance"].values == pytest.approx(by_hand, rel=1e-12)
    assert found["compliance"].values == pytest.approx(machine()[:, :2, :1], rel=1e-9)
    assert any("only the reaction along x" in note for note in notes)


def test_it_undoes_itself_and_nothing_is_nothing() -> None:
    first, _ = without_mass(labelled(machine()), 0.0)
    assert first["compliance"].values == pytest.approx(machine())
    twice, _ = without_mass(without_mass(labelled(machine(3.0)), 1.0)[0], 2.0)
    once, _ = without_mass(labelled(machine(3.0)), 3.0)
    assert twice["compliance"].values == pytest.approx(once["compliance"].values, rel=1e-9)


def test_names_of_axes_are_names() -> None:
    turned = labelled(machine(3.0), "zxy", "yzx")
    found, _ = without_mass(turned, 3.0)
    values = found["compliance"].sel(response=list("xyz"), excitation=list("xyz")).values
    assert values == pytest.approx(machine(), rel=1e-9)


def test_errors_are_carried_along() -> None:
    """Against 2000 draws of measured matrices, each with its mass taken off: within 5 % at every entry."""
    rng, std = np.random.default_rng(2), 1e-9
    line = int(np.argmin(np.abs(F - 90.0)))
    loaded = machine(3.0)[line : line + 1]
    noise = rng.standard_normal((2, 2000, 3, 3)) * std / np.sqrt(2.0)
    draws = loaded + noise[0] + 1j * noise[1]
    inverse = np.linalg.inv(np.eye(3) + 3.0 * (2.0 * np.pi * F[line]) ** 2 * draws)
    scatter = (draws @ inverse).std(axis=0)
    found, _ = without_mass(labelled(machine(3.0), std=std), 3.0)
    assert found["compliance_std"].values[line] == pytest.approx(scatter, rel=0.05)
    assert interval(found)["upper"].dims == ("frequency", "response", "excitation")


def test_lines_that_only_some_columns_claim_are_corrected_as_far_as_they_go() -> None:
    values = machine(3.0, "x")
    partial = values.copy()
    partial[:50, :, 1:] = np.nan
    found, _ = without_mass(labelled(partial), 3.0)
    assert np.isnan(found["compliance"].values[:50, :, 1:]).all()
    assert found["compliance"].values[:50, :, :1] == pytest.approx(machine()[:50, :, :1], rel=1e-9)


def test_what_cannot_be_taken_off() -> None:
    with pytest.raises(InputError, match="no axis was both excited"):
        without_mass(labelled(machine(), "yz", "x"), 0.1)
    with pytest.raises(InputError, match="an attached mass of -1 kg; give zero or a positive mass"):
        without_mass(labelled(machine()), -1.0)
