"""Claims: cutting tests of a campaign file bracket limits against which their model is tested."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from exam.limits import RATIO, SLOT, SPEEDS, planted
from truth.cutting import FEEDS, Cut, Mill, forces
from truth.milling_limits import Found, search

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.commands.diagnose import diagnose
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.cases.cutting import cutting_case
from smfe.diagnosis.cutting.orders import CuttingOrders

RATE = 500.0


def cut(file: Path, speed: float, chatter: float | None, seed: int) -> None:
    """Vibration of a cut: teeth, run-out, noise, and a chatter frequency where it chatters."""
    t = np.arange(0.0, 12.0, 1.0 / RATE)
    turn = speed / 60.0
    a = 0.4 * np.sin(2 * np.pi * turn * t) + sum(np.cos(2 * np.pi * k * SLOT.teeth * turn * t) / k for k in (1, 2, 3))
    if chatter is not None:
        a = a + 8.0 * np.sin(2 * np.pi * chatter * t)
    a = a + 0.02 * np.random.default_rng(seed).standard_normal(t.size)
    np.savetxt(file, np.column_stack([t, a]), delimiter=",", header="t,a", comments="", fmt="%.6g")


def written(folder: Path, found: list[Found], baseline: str = 'limits = "bench"', observed: bool = False) -> Path:
    """A campaign file: the mill as identified, and two cutting tests a limit."""
    m = SLOT.modes
    modes = ", ".join(
        f'{{ frequency = "{f} Hz", damping = {z}, stiffness = "{k} N/m", direction = [{x}, {y}, 0] }}'
        for f, z, k, (x, y) in zip(m.frequency, m.damping, m.stiffness, m.direction, strict=True)
    )
    lines = [
        '[campaign]\nname = "cuts"',
        f'[tool]\ndiameter = "{SLOT.diameter * 1e3} mm"\nteeth = {SLOT.teeth}\napproach_angle = "90 deg"',
        f'[material]\nname = "C45"\nKtc = "{SLOT.kt * 1e-6} N/mm^2"\nKrc = "{SLOT.kr * 1e-6} N/mm^2"\nKac = "0 N/mm^2"',
        '[channels]\ntime = { column = "t", unit = "s" }\nacceleration_x = { column = "a", unit = "m/s^2" }',
        f'[[model]]\nname = "bench"\nmodes = [ {modes} ]',
        f"[baseline]\n{baseline}",
    ]
    for number, f in enumerate(found):
        for verdict, depth, measured in (("stable", f.stable, None), ("chatter", f.chatter, f.frequency)):
            name = f"{number}_{verdict}.csv"
            cut(folder / name, f.speed, measured, number)
            lines.append(
                f'[[cutting_test]]\nfile = "{name}"\nspindle_speed = "{f.speed} rpm"\n'
                f'depth_of_cut = "{depth * 1e3} mm"\n'
                f'cut = "central"\nwidth_of_cut = "{SLOT.diameter * 1e3} mm"\nfeed_per_tooth = "{f.feed * 1e3} mm"'
                + (f'\nobserved = "{verdict}"' if observed else "")
            )
    path = folder / "campaign.toml"
    path.write_text("\n".join(lines))
    return path


@pytest.mark.slow
def test_a_harder_material_is_named_from_the_cutting_tests_of_a_campaign(tmp_path: Path) -> None:
    """15 % harder, on a machine as it was identified: limits know compliance times coefficients only.

    Within the tolerances of a campaign that states none (damping 10 %, stiffness 3 %, coefficients 10 %) it would be no
    finding. What softer modes would do as well stands in the same set.
    """
    mill = planted("coefficients", 1.0)
    path = written(tmp_path, search(mill, SPEEDS, np.random.default_rng(41), RATIO), observed=True)
    known = 'uncertainty = { frequency = "0.2 %", damping = "2 %", stiffness = "1 %" }\nmodes = ['
    stated = path.read_text().replace("modes = [", known).replace("[material]", '[material]\nuncertainty = "3 %"')
    path.write_text(stated)
    found = diagnose(path, tmp_path / "finding.json")
    assert found.verdict == "named"
    causes = [(c.id, c.variant, c.set) for c in found.causes]
    assert causes == [("force_coefficients", "declared", 1), ("modal_scale", "declared", 1)]
    size = next(p for p in found.causes[0].parameters if p.name == "coefficients")
    assert size.value == pytest.approx(15.0, abs=3.0)
    written_finding = json.loads((tmp_path / "finding.json").read_text())
    depths = written_finding["stable_depth"]
    assert len(depths) == 16
    ratio = [row["after_mm"] / row["before_mm"] for row in depths]
    assert ratio == pytest.approx([1.0 / (1.0 + size.value / 100.0)] * 16, rel=0.02)
    # The extended model is a campaign beside the finding, and of it nothing is left to find.
    again = diagnose(tmp_path / "finding.toml", tmp_path / "again.json")
    assert (again.verdict, again.causes) == ("consistent", ())
    assert (tmp_path / "again.toml").is_file()


def test_limits_and_chatter_frequencies_are_those_of_the_cutting_tests(tmp_path: Path) -> None:
    tests = [Found(300.0, 1e-4, 1.9e-3, 2.1e-3, 72.6), Found(500.0, 1e-4, 2.9e-3, 3.1e-3, 70.8)]
    case = case_of(load_campaign(written(tmp_path, tests)), {})
    assert [c.name for c in case.family.conditions] == [
        f"limit at {n} rpm, central, {SLOT.diameter * 1e3:g} mm wide, 0.1 mm per tooth" for n in (300, 500)
    ]
    for condition, test in zip(case.family.conditions, tests, strict=True):
        limit = condition.data.limit
        assert limit.depth == pytest.approx(math.sqrt(test.stable * test.chatter))
        assert limit.depth_std == pytest.approx(math.log(test.chatter / test.stable) / math.sqrt(12.0))
        assert limit.frequency == pytest.approx(test.frequency, abs=0.02)
        assert case.groups[f"{tests.index(test)}_stable.csv"] == (condition.name,)


def test_what_cannot_be_tested_is_refused(tmp_path: Path) -> None:
    one = [Found(300.0, 1e-4, 1.9e-3, 2.1e-3, 71.3)]
    chattering = written(tmp_path, one, observed=True)
    chattering.write_text(chattering.read_text().replace('observed = "stable"', 'observed = "chatter"'))
    with pytest.raises(InputError, match=r"no limit is bracketed .* at 300 rpm every cut chattered.* other side"):
        case_of(load_campaign(chattering), {})
    with pytest.raises(InputError, match=r"baseline.limits: 'bnch' is neither a measurement nor a model"):
        load_campaign(written(tmp_path, one, 'limits = "bnch"'))
    with pytest.raises(InputError, match="one simulation is tested at a time"):
        load_campaign(written(tmp_path, one, 'limits = "bench"\nforces = "mechanistic"'))
    with pytest.raises(InputError, match=r"add \[\[cutting_test\]\]s that bracket the limit"):
        load_campaign(written(tmp_path, []))


def test_limits_are_those_of_one_controller(tmp_path: Path) -> None:
    found = [Found(300.0, 1e-4, 1.9e-3, 2.1e-3, 71.3), Found(500.0, 1e-4, 2.9e-3, 3.1e-3, 70.8)]
    path = written(tmp_path, found, observed=True)
    tables = path.read_text().split("[[cutting_test]]")
    under = [
        f'{text}\ncontroller = "{name}"\n' for text, name in zip(tables[1:], ("K1", "K1", "K2", "K2"), strict=True)
    ]
    path.write_text("[[cutting_test]]".join([tables[0] + "\n", *under]))
    with pytest.raises(
        InputError, match="made with the controller K1 and K2, whose limits are not those of one machine"
    ):
        case_of(load_campaign(path), {})


START = 10.0  # of the clock of a record [s]


def milled(folder: Path, cut: Cut, whole: float, cutting: tuple[float, float], more: str = "") -> Path:
    """A slot on a clock that does not begin at zero: `cutting` of a record, air beside it, a zero that is none."""
    mill = Mill()
    t = np.arange(0.0, whole, 2e-4) + START
    inside = np.clip(np.minimum(t - cutting[0], cutting[1] - t) / 0.05, 0.0, 1.0)
    force = forces(mill, cut, 2.0 * np.pi * cut.speed / 60.0 * t, 8) * inside
    force += np.array([[30.0], [-20.0], [10.0]]) + 0.1 * np.random.default_rng(1).standard_normal(force.shape)
    np.savetxt(folder / "cut.csv", np.column_stack([t, force.T]), delimiter=",", header="t,x,y,z", comments="")
    k = [f'{n} = "{v * 1e-6} N/mm^2"' for n, v in zip(("Ktc", "Krc", "Kac"), mill.cutting, strict=True)]
    lines = [
        f'[campaign]\nname = "air"\n[tool]\ndiameter = "{mill.diameter * 1e3} mm"\nteeth = {mill.teeth}\n[material]',
        *k,
        '[channels]\ntime = { column = "t", unit = "s" }',
        *(f'force_{a} = {{ column = "{a}", unit = "N" }}' for a in "xyz"),
        f'[baseline]\nforces = "mechanistic"\n[[cutting_test]]\nfile = "cut.csv"\nspindle_speed = "{cut.speed} rpm"',
        f'depth_of_cut = "{cut.depth * 1e3} mm"\ncut = "central"\nwidth_of_cut = "{mill.diameter * 1e3} mm"',
        f'feed_per_tooth = "{cut.feed_per_tooth * 1e3} mm"\n{more}',
    ]
    (folder / "campaign.toml").write_text("\n".join(lines))
    return folder / "campaign.toml"


@pytest.mark.parametrize("more", ["", 'interval = ["11.2 s", "13.8 s"]'], ids=["found", "interval"])
def test_air_beside_a_cut_changes_no_force_of_it(tmp_path: Path, more: str) -> None:
    """Two seconds of air in five would take 40 % off the forces; the zero of the dynamometer is what it shows there."""
    cut = Cut(feed_per_tooth=FEEDS[1].feed_per_tooth)
    case = cutting_case(load_campaign(milled(tmp_path, cut, 5.0, (START + 1.0, START + 4.0), more)))
    found = case.family.conditions[0].data
    assert isinstance(found, CuttingOrders)
    truth = np.fft.rfft(forces(Mill(), cut, 2.0 * np.pi * np.arange(3600) / 3600, 8))[:, :9].T / 3600
    truth[1:] *= 2.0
    largest = np.abs(truth).max()
    np.testing.assert_allclose(np.abs(found.value[:9]), np.abs(truth), atol=0.005 * largest)
    np.testing.assert_allclose(found.value[0].real, truth[0].real, atol=0.005 * largest)
    notes = [s.evidence for s in case.suspects if s.where == "cutting test, cut.csv"]
    said = [
        x for n in notes if (x := re.match(r"the steady cut lasts from (.*) to (.*) s of a record from 10 to 15 s", n))
    ]
    assert len(said) == (not more)
    for x in said:
        assert [float(t) for t in x.groups()] == pytest.approx([START + 1.0, START + 4.0], abs=0.2)
