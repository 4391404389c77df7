"""Claims: the distance of a measurement from a declared model is a share of the model; of a zero entry none."""

import numpy as np
import pytest

from process import ModalModel
from process.labels import make_compliance
from smfe.campaign import Model
from smfe.commands.compare import model_errors
from smfe.identification.errors.result import Identification


def test_an_entry_that_the_model_says_is_zero_has_no_relative_error() -> None:
    machine = ModalModel([50.0], [0.03], [1e6], [[1.0, 0.0, 0.0]])
    frequency = np.linspace(20.0, 80.0, 61)
    measured = 1.1 * machine.matrix(frequency)[:, :2, :2] + 1e-9
    found = {"tap": Identification("tap", "hammer", make_compliance(frequency, measured, ("x", "y"), ("x", "y")))}
    errors = model_errors(found, [Model("one mode", machine)])
    assert list(errors[["response", "excitation"]].itertuples(index=False, name=None)) == [("x", "x")]
    assert errors["error_percent"].item() == pytest.approx(10.0, rel=0.02)
