"""Fail if a wheel holds anything but the three packages, or lacks their data files."""

import sys
import zipfile

PACKAGES = {"smfe", "process", "stability"}
DATA = {
    *(f"{package}/py.typed" for package in PACKAGES),
    "smfe/reporting/static/plotly-cartesian.min.js",
    "smfe/reporting/static/plotly-cartesian.min.js.LICENSE.txt",
}

if __name__ == "__main__":
    (wheel,) = sys.argv[1:]
    names = set(zipfile.ZipFile(wheel).namelist())
    top = {name.split("/")[0] for name in names}
    extra = {name for name in top - PACKAGES if not name.endswith(".dist-info")}
    missing = (PACKAGES - top) | (DATA - names)
    junk = {name for name in names if name.endswith((".pyc", ".nbi", ".nbc"))}
    for title, found in (("unexpected at the top", extra), ("missing", missing), ("caches", junk)):
        if found:
            sys.exit(f"{wheel}: {title}: {', '.join(sorted(found))}")
    print(f"{wheel}: {len(names)} files, top level {', '.join(sorted(top))}")
