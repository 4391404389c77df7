"""A campaign of a hundred measurements has pictures, too: the legend leaves room for what it names."""

import numpy as np

from process.labels import make_compliance
from smfe.reporting.content.results import Measurement
from smfe.reporting.content.style import Line
from smfe.reporting.figures.draw_matplotlib import MOST_NAMES, draw_compliance


def test_a_hundred_curves_have_a_legend_of_the_first_and_the_last() -> None:
    f = np.linspace(10.0, 300.0, 20)
    curve = make_compliance(f, 1e-8 / (1.0 - (f / 200.0) ** 2 + 0.06j * f / 200.0)[:, None, None], ["x"], ["x"])
    many = [Measurement(f"m{k}", "hammer", curve) for k in range(100)]
    figure = draw_compliance(many, {m.name: Line("#000000", "solid") for m in many})
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(named) == MOST_NAMES
    assert named[0] == "m0"
    assert named[-1] == "m99"
    assert f"and {100 - MOST_NAMES + 1} more" in named
    assert figure.axes[0].get_position().height > 0.5
    assert len(figure.axes[0].lines) >= 100
