"""Cutting tests of a campaign: what the criterion says of each, beside what each source of lobes predicts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, LobeRequest
from smfe.kept import file_hash, key_of
from smfe.limits.campaign_lobes import check_sources, is_machine, limits_of
from smfe.limits.cut_conditions import ALIKE, FIXED, Source, apart, direction_text, feed_of, sources_of
from smfe.progress import Progress
from smfe.records import read_records
from smfe.results import FAILED, PREDICTION, TEST, Failure, Failures, attempt, failure_of, write_csv, write_groups
from smfe.stored import Store
from stability import ChatterVerdict, chatter_verdict
from stability.chatter.criterion import FREQUENCY_RANGE, AxisVerdict
from stability.chatter.rules import RULES

NOT_COMPARED = "not compared"
"""Prediction of a source that belongs to another controller, position or feed than the cut."""

FEED_APART = 0.1
"""Share by which a stated feed may differ from that of teeth and speed."""


@dataclass(frozen=True)
class Verdicts:
    """What the cutting tests say.

    Parameters
    ----------
    rows : list of dict
        Rows of chatter.csv, one a cutting test.
    spectra : mapping of str to xarray.Dataset
        "test_1", "test_2", ... -> spectrum with the verdict in its attributes, of those that could be judged.
    warnings : tuple of str
        Tests that no source of lobes belongs to, or of which this cannot be known.
    """

    rows: list[dict[str, Any]]
    spectra: Mapping[str, xr.Dataset]
    warnings: tuple[str, ...] = ()


def judge_all(
    campaign: Campaign,
    compliances: Mapping[str, xr.Dataset],
    progress: Progress,
    failures: Failures | None = None,
    kept: Path | None = None,
) -> Verdicts:
    """Judge every cutting test, with what each source of lobes predicts for it.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[cutting_test]]``.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    progress : callable
        Called with (what, done, of).
    failures : list of Failure, optional
        Collects tests that cannot be judged, whose row then has the verdict "failed" and the reason, and sources that
        predict nothing for a test. Tests that are among them already are not judged. None: the first one is raised.
    kept : Path, optional
        Where verdicts are kept, and found again while neither record nor settings have changed.
    """
    rows: list[dict[str, Any]] = []
    spectra: dict[str, Callable[[], xr.Dataset]] = {}
    store = verdict_store(kept)
    unpredicted: Failures | None = None if failures is None else []
    for i, test in enumerate(campaign.cutting_tests):
        progress(f"judging {test.file.name}", i, len(campaign.cutting_tests))
        predicted = predictions(campaign, test, compliances, unpredicted, failures)
        if test.depth_of_cut == 0.0:
            air = _row(campaign, test, None, "the spindle turns in air: nothing is cut")
            rows.append(air | predicted | {"verdict": "undecided"})
            continue
        gone = [f for f in failures or () if (f.part, f.name) == (TEST, test.file.name)]
        if gone:
            rows.append(_row(campaign, test, None, gone[0].reason) | predicted)
            continue
        try:
            verdict = judged(campaign, test, store)
        except Exception as error:
            if failures is None:
                raise
            failures.append(failure_of(TEST, test.file.name, error))
            rows.append(_row(campaign, test, None, failures[-1].reason) | predicted)
            continue
        rows.append(_row(campaign, test, verdict, verdict.reason) | predicted)
        name = f"test_{i + 1}"
        if store.folder is None:
            assert campaign.tool is not None
            spectra[name] = partial(xr.Dataset.copy, _spectrum_of(test, verdict, campaign.tool.teeth, rows[-1]))
        else:  # A thousand spectra need not lie in memory.
            spectra[name] = partial(_kept_spectrum, campaign, test, store, _key(campaign, test, store), rows[-1])
    store.forget_others()
    if failures is not None:
        failures += _once(unpredicted or [])
    return Verdicts(rows, _WhenAsked(spectra), condition_warnings(campaign))


class _WhenAsked(Mapping[str, xr.Dataset]):
    """Datasets, each made when it is asked for."""

    def __init__(self, make: Mapping[str, Callable[[], xr.Dataset]]) -> None:
        self._make = make

    def __getitem__(self, name: str) -> xr.Dataset:
        return self._make[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._make)

    def __len__(self) -> int:
        return len(self._make)


def _kept_spectrum(campaign: Campaign, test: CuttingTest, store: Store, key: str, row: Mapping[str, Any]) -> xr.Dataset:
    """Return the spectrum of a test, read back from where its verdict is kept under a key: the record may be gone."""
    assert campaign.tool is not None
    return _spectrum_of(test, store.get(key, partial(judge, campaign, test)), campaign.tool.teeth, row)


def verdict_store(kept: Path | None) -> Store:
    """Return where verdicts of cutting tests are kept."""
    return Store(kept, "cut", ChatterVerdict, AxisVerdict)


def judged(campaign: Campaign, test: CuttingTest, store: Store) -> ChatterVerdict:
    """Return the verdict of a cutting test, as it was kept while neither record nor settings have changed."""
    return store.get(_key(campaign, test, store), partial(judge, campaign, test))


def _key(campaign: Campaign, test: CuttingTest, store: Store) -> str:
    return "" if store.folder is None else key_of(test, campaign.tool, file_hash(test.file))


def _once(failures: Failures) -> Failures:
    """Return what a source cannot predict once for all tests of which the same is said."""
    files: dict[tuple[str, str], list[str]] = {}
    for f in failures:
        source, _, file = f.name.partition("\n")
        files.setdefault((source, f.reason), []).append(file)
    return [
        Failure(PREDICTION, f"{source} for {tests[0] if len(tests) == 1 else f'{len(tests)} cutting tests'}", reason)
        for (source, reason), tests in files.items()
    ]


def write_verdicts(folder: Path, verdicts: Verdicts) -> None:
    """Write chatter.csv and spectra.nc, or remove those of an earlier run when nothing was judged."""
    if not verdicts.rows:
        for name in ("chatter.csv", "spectra.nc"):
            (folder / name).unlink(missing_ok=True)
        return
    write_csv(folder / "chatter.csv", pd.DataFrame(verdicts.rows))
    write_groups(folder / "spectra.nc", verdicts.spectra)


def judge(campaign: Campaign, test: CuttingTest) -> ChatterVerdict:
    """Return what the spectral criterion says of the record of a cutting test.

    Raises
    ------
    InputError
        When the record cannot be read or judged.
    """
    assert campaign.tool is not None
    record = read_records(test.file, test.channels)[0]
    quantity = test.quantity or (None if test.floor is None else test.floor[1])
    if test.floor is not None and test.floor[1] != quantity:
        raise InputError(f"cutting test '{test.file.name}': floor is one of {test.floor[1]}, {quantity} is judged")
    try:
        return chatter_verdict(
            record,
            test.spindle_speed * math.pi / 30.0,
            campaign.tool.teeth,
            quantity=quantity,
            axes=test.axes,
            frequency_range=test.frequency_range or FREQUENCY_RANGE,
            floor=None if test.floor is None else test.floor[0],
            interval=test.interval,
            half_order_reference=test.half_order_reference,
        )
    except InputError as error:
        raise InputError(f"cutting test '{test.file.name}': {error}") from error


def _row(campaign: Campaign, test: CuttingTest, verdict: ChatterVerdict | None, reason: str) -> dict[str, Any]:
    """Return what the criterion says of a test; without a verdict the test failed, and the reason says why."""
    head = {
        "file": test.file.name,
        "spindle_speed_rpm": round(test.spindle_speed, 6),
        "depth_of_cut_mm": round(test.depth_of_cut * 1e3, 9),
    }
    given = {
        "observed": test.observed or "",
        "controller": test.controller or "",
        "position": test.position or "",
        "feed_mm_min": math.nan if test.feed is None else round(_speed(test.feed) * 6e4, 9),
    }
    end = {
        "half_order_reference": math.nan if test.half_order_reference is None else test.half_order_reference,
        "lobes": _matching_request(campaign, test),
        "reason": reason,
    }
    if verdict is None:
        return {**head, "verdict": FAILED, "ratio": math.nan, "chatter_frequency_Hz": math.nan, **given, **end}
    return {
        **head,
        "verdict": verdict.verdict,
        "ratio": verdict.ratio,
        "chatter_frequency_Hz": verdict.chatter_frequency_Hz,
        "tooth_passing_harmonic_Hz": verdict.tooth_passing_harmonic_Hz,
        **given,
        "quantity": verdict.quantity,
        "axes": " ".join(verdict.axes),
        "axis_verdicts": "; ".join(f"{a.axis} {a.verdict}" for a in verdict.by_axis),
        "family_Hz": " ".join(f"{line:.4g}" for line in verdict.family_Hz),
        "growth": verdict.growth,
        "try_rpm": " ".join(f"{speed:.0f}" for speed in verdict.try_rpm),
        "notes": "; ".join(verdict.notes),
        "cut_start_s": verdict.cut_s[0],
        "cut_end_s": verdict.cut_s[3],
        "interval_start_s": verdict.interval_s[0],
        "interval_end_s": verdict.interval_s[1],
        "frequency_low_Hz": verdict.frequency_range_Hz[0],
        "frequency_high_Hz": verdict.frequency_range_Hz[1],
        "floor": f"{verdict.floor:g} {verdict.unit}",
        "half_order_ratio": verdict.half_order_ratio,
        **end,
    }


def _speed(feed: Mapping[str, float]) -> float:
    found = feed_of(feed)
    return math.hypot(*feed.values()) if found is None else found.speed


def not_compared(request: LobeRequest, source: Source, test: CuttingTest) -> str:
    """Return why a source of lobes is not that of a cutting test; empty where nothing that is stated differs.

    Controller and position must be the same. A cut that is fed in another direction than the lobes is predicted in its
    own axes; an operating point was measured in motion, and holds for the direction of that motion only.
    """
    differs = source.differs(test)
    if differs or test.feed is None:
        return differs
    feed = feed_of(test.feed)
    if feed is None:
        return "the cut is fed along the tool axis"
    if request.method != "operating_point" or feed.direction is None:
        return ""
    if ALIKE < apart(feed.direction, request.feed_direction) < math.pi - ALIKE:
        return f"fed along {direction_text(request.feed_direction)}, the cut along {direction_text(feed.direction)}"
    return ""


def condition_warnings(campaign: Campaign) -> tuple[str, ...]:
    """Return what cannot be compared, or only on an assumption, because of controller, position and feed.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]`` and ``[[cutting_test]]``.
    """
    sources = [(r, s) for r in campaign.lobes for s in sources_of(campaign, r)]
    warnings: dict[str, list[str]] = {}
    for test in campaign.cutting_tests:
        why = [(s.label, not_compared(r, s, test)) for r, s in sources]
        if sources and all(reason for _, reason in why):
            each = "; ".join(dict.fromkeys(f"{label}: {reason}" for label, reason in why))
            warnings.setdefault(f"no source of lobes belongs to it, so nothing is predicted ({each})", []).append(
                test.file.name
            )
        for key in FIXED:
            own, known = getattr(test, key), {getattr(s, key) for _, s in sources}
            names = sorted(v for v in known if v is not None)
            if own is None and len(names) > 1:
                text = f"states no {key}, and the lobes are of {' and '.join(names)}: one of them at most predicts it"
                warnings.setdefault(f"{text}; add {key} to the [[cutting_test]]", []).append(test.file.name)
        if test.feed is not None and test.feed_per_tooth is not None and campaign.tool is not None:
            stated = 6e4 * _speed(test.feed)
            feed = 1e3 * test.feed_per_tooth * campaign.tool.teeth * test.spindle_speed
            if abs(stated - feed) > FEED_APART * feed:
                text = f"states a feed of {stated:.4g} mm/min, and its speed, teeth and feed_per_tooth make {feed:.4g}"
                own_feed = any(request.feed is not None for request in campaign.lobes)
                which = "that of their [[lobes]] where one is given, else the latter" if own_feed else "the latter"
                warnings.setdefault(f"{text}; predictions take {which}", []).append(test.file.name)
    return tuple(
        f"{files[0] if len(files) == 1 else f'{len(files)} cutting tests ({files[0]}, ...)'}: {text}"
        for text, files in warnings.items()
    )


def predictions(
    campaign: Campaign,
    test: CuttingTest,
    compliances: Mapping[str, xr.Dataset],
    failures: Failures | None = None,
    known: Failures | None = None,
) -> dict[str, Any]:
    """Return limit, verdict and chatter frequency that each source of lobes predicts for a test, by their own method.

    Without lobes there is none, and no work material is needed. A source of another controller, position or feed is not
    compared; the row says which in ``not_compared``.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]``.
    test : CuttingTest
        The cut.
    compliances : mapping of str to xarray.Dataset
        Measurement or model -> compliance.
    failures : list of Failure, optional
        Collects sources that fail, as "SOURCE, newline, FILE"; their prediction is "failed". None: raised.
    known : list of Failure, optional
        What has failed before: a source whose measurement failed is not said once more.
    """
    row: dict[str, Any] = {"not_compared": ""} if campaign.lobes else {}
    for request in campaign.lobes:
        feed = None if test.feed is None else feed_of(test.feed)
        own = None if feed is None else feed.direction
        here = replace(
            request,
            cut=test.cut,
            width_of_cut=test.width_of_cut,
            feed_per_tooth=test.stated_feed_per_tooth,
            spindle_speed=np.array([test.spindle_speed]),
            feed_direction=request.feed_direction if own is None else own,
            feed=request.feed if request.feed is None or not test.feed else _speed(test.feed),
        )
        for of in sources_of(campaign, request):
            source, names = of.label, of.names
            if f"limit_{source}_mm" in row:
                continue
            row |= {f"limit_{source}_mm": math.nan, f"predicted_{source}": FAILED, f"frequency_{source}_Hz": math.nan}
            reason = not_compared(request, of, test)
            if reason:
                row[f"predicted_{source}"] = NOT_COMPARED
                row["not_compared"] = "; ".join(filter(None, [row["not_compared"], f"{source}: {reason}"]))
                continue
            missing = not set(names) <= set(compliances) and not is_machine(campaign, names)
            if known is not None and missing:
                continue  # said by the lobes of this source
            with attempt(failures, PREDICTION, f"{source}\n{test.file.name}"):
                if not is_machine(campaign, names):
                    check_sources(names, compliances, known)
                at = replace(here, controller=of.controller, position=of.position)
                found = limits_of(campaign, at, names, compliances)
                limit = float(found["limit_depth"].values[0])
                if (
                    math.isnan(limit)
                    and "stable_to" in found
                    and test.depth_of_cut * 1e3 <= float(found["stable_to"][0])
                ):
                    row[f"predicted_{source}"] = "stable"
                    continue
                if math.isnan(limit):
                    row[f"predicted_{source}"] = NOT_COMPARED
                    why = "; ".join(w for w in found.attrs["warnings"] if "not known" in w)
                    row["not_compared"] = "; ".join(filter(None, [row["not_compared"], f"{source}: {why}"]))
                    continue
                row[f"limit_{source}_mm"] = limit
                row[f"predicted_{source}"] = "chatter" if test.depth_of_cut * 1e3 > limit else "stable"
                row[f"frequency_{source}_Hz"] = float(found["chatter_frequency"].values[0])
    return row


def _matching_request(campaign: Campaign, test: CuttingTest) -> str:
    """Return the lobes on whose diagram a test belongs: same cut, width and feed, and a source of its own."""
    feed = None if test.feed is None else feed_of(test.feed)
    for request in campaign.lobes:
        alike = request.cut == test.cut and math.isclose(request.width_of_cut, test.width_of_cut, rel_tol=1e-6)
        if feed is not None and feed.direction is not None:
            alike &= apart(feed.direction, request.feed_direction) <= ALIKE
        if alike and not all(not_compared(request, s, test) for s in sources_of(campaign, request)):
            return request.name
    return ""


def _spectrum_of(test: CuttingTest, verdict: ChatterVerdict, teeth: int, row: Mapping[str, Any]) -> xr.Dataset:
    sources = [k.removeprefix("predicted_") for k in row if k.startswith("predicted_")]
    marks = {s: row[f"frequency_{s}_Hz"] for s in sources}
    predicted = {source: f for source, f in marks.items() if math.isfinite(f)}
    return spectrum_of(verdict).assign_attrs(
        file=test.file.name,
        spindle_speed_rpm=round(test.spindle_speed, 6),
        depth_of_cut_mm=round(test.depth_of_cut * 1e3, 9),
        tooth_passing_frequency_Hz=teeth * verdict.spindle_speed_rpm / 60.0,
        teeth=teeth,
        predicted_Hz=json.dumps(predicted),
    )


def spectrum_of(verdict: ChatterVerdict) -> xr.Dataset:
    """Return the spectrum of a verdict, the spectrogram beside it, with what the criterion said in its attributes."""
    whole = verdict.spectrum if verdict.spectrogram is None else with_picture(verdict.spectrum, verdict.spectrogram)
    return whole.assign_attrs(
        spindle_speed_rpm=verdict.spindle_speed_rpm,
        verdict=verdict.verdict,
        ratio=verdict.ratio,
        chatter_frequency_Hz=verdict.chatter_frequency_Hz,
        tooth_passing_harmonic_Hz=verdict.tooth_passing_harmonic_Hz,
        quantity=verdict.quantity,
        reason=verdict.reason,
        cut_s=json.dumps(list(verdict.cut_s)),
        interval_s=json.dumps(list(verdict.interval_s)),
        family_Hz=json.dumps(list(verdict.family_Hz)),
        **_threshold(verdict),
    )


def _threshold(verdict: ChatterVerdict) -> dict[str, Any]:
    """Return the axis that has decided, and the amplitude above which a line of it is chatter."""
    axis = next((a.axis for a in verdict.by_axis if a.ratio == verdict.ratio), None)
    if axis is None:
        return {}
    # As the criterion: the highest order of this axis, a share of the highest of all axes, the floor.
    orders = verdict.spectrum["amplitude"].where(verdict.spectrum["harmonic"], 0.0).max("frequency")
    reference = max(float(orders.sel(axis=axis)), RULES.silent * float(orders.max()), verdict.floor)
    return {"threshold_axis": axis, "threshold_amplitude": verdict.threshold * reference}


PICTURE_STEP = 0.5
"""Step of the levels of a stored spectrogram [dB]: a byte a point holds 127 dB."""


def with_picture(spectrum: xr.Dataset, spectrogram: xr.Dataset) -> xr.Dataset:
    """Return a spectrum with the spectrogram of all axes (root of the sum of squares) beside it, a byte a point.

    Parameters
    ----------
    spectrum, spectrogram : xarray.Dataset
        Those of a `ChatterVerdict`.
    """
    size = np.sqrt((spectrogram["amplitude"].values.astype(float) ** 2).sum(axis=0))
    top = max(float(size.max(initial=0.0)), np.finfo(float).tiny)
    level = 255.0 + 20.0 * np.log10(np.maximum(size / top, 1e-12)) / PICTURE_STEP
    levels = xr.Variable(
        ("picture_time", "picture_frequency"),
        np.round(np.clip(level, 0.0, 255.0)).astype(np.uint8),
        {"long_name": f"level in steps of {PICTURE_STEP:g} dB, 255 at top", "top": top, "step_dB": PICTURE_STEP}
        | spectrogram.attrs,
        {"zlib": True, "complevel": 4},
    )
    coords = {
        "picture_time": ("picture_time", spectrogram["time"].values, {"units": "s"}),
        "picture_frequency": ("picture_frequency", spectrogram["frequency"].values, {"units": "Hz"}),
    }
    return spectrum.assign(spectrogram=levels).assign_coords(coords)
