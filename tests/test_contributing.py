"""The page for developers names files that are there: it is how somebody new finds a line."""

import re

from places import CHECKOUT

PAGE = CHECKOUT / "docs" / "contributing.md"
NAMED = re.compile(r"`((?:smfe|stability|process|tests|datasets|docs|\.ci)/[\w./]*)`")


def test_every_file_that_the_page_for_developers_names_is_there() -> None:
    named = NAMED.findall(PAGE.read_text(encoding="utf-8"))
    assert len(named) > 40
    assert [name for name in named if not (CHECKOUT / name).exists()] == []


def test_every_room_of_the_packages_stands_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    rooms = [
        f.parent for package in ("process", "stability", "smfe") for f in CHECKOUT.glob(f"{package}/*/__init__.py")
    ]
    assert len(rooms) > 20
    assert [room.name for room in rooms if f"{room.name}/" not in page] == []
