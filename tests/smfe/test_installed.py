"""What is tested is what is installed: the wheel, where it is asked for, with three packages and no more."""

import importlib
import json
import os
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from places import CHECKOUT

PACKAGES = ("smfe", "process", "stability")


def is_editable(installed: Distribution) -> bool:
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    return bool(origin.get("dir_info", {}).get("editable", False))


@pytest.fixture(scope="module")
def installed() -> Distribution:
    return distribution("smfe")


def folder(package: str) -> Path:
    return Path(importlib.import_module(package).__file__).resolve().parent


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_the_installed_one(package):
    if os.environ.get("SMFE_TEST_WHEEL") != "1":
        pytest.skip("the wheel is not under test: run `make test INSTALL=wheel`")
    assert folder(package).parent.name == "site-packages"
    assert folder(package) != CHECKOUT / package


@pytest.mark.parametrize("package", PACKAGES)
def test_package_declares_its_types(package):
    assert (folder(package) / "py.typed").is_file()


def test_wheel_under_test_is_not_an_editable_install(installed):
    if os.environ.get("SMFE_TEST_WHEEL") != "1":
        pytest.skip("the wheel is not under test: run `make test INSTALL=wheel`")
    assert not is_editable(installed)


def test_top_level_is_exactly_the_three_packages(installed):
    if is_editable(installed):
        pytest.skip("an editable install has no top level of its own: run `make test INSTALL=wheel`")
    # The command line script is listed relative to site-packages, as ../../../bin/smfe.
    top = {file.parts[0] for file in installed.files if file.parts[0] != ".."}
    assert top == {*PACKAGES, f"smfe-{installed.version}.dist-info"}
