"""The scenario file: a known machine, instruments and trials -> records and the campaign that reads them."""

from smfe.scenario.scenario import Scenario, load_scenario

__all__ = ["Scenario", "load_scenario"]
