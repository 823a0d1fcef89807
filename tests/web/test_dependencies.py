"""What npm installs for the tests in a browser is pinned, and free for all uses."""

import json
import re

from tests.support.browser import WEB

PERMISSIVE = {"0BSD", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "ISC", "MIT", "PSF-2.0", "Python-2.0"}
LOCK = json.loads((WEB / "package-lock.json").read_text())["packages"]


def test_versions_are_exact_and_those_of_the_lock_file():
    package = json.loads((WEB / "package.json").read_text())
    assert "dependencies" not in package
    versions = package["devDependencies"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in versions.values())
    assert versions == LOCK[""]["devDependencies"]
    assert versions == {name: LOCK[f"node_modules/{name}"]["version"] for name in versions}


def test_every_package_has_a_permissive_licence_and_a_digest():
    packages = {path: entry for path, entry in LOCK.items() if path}
    assert packages
    choices = [set(entry["license"].strip("()").split(" OR ")) for entry in packages.values()]
    assert all(choice & PERMISSIVE for choice in choices)
    assert all(entry["integrity"].startswith("sha512-") and entry["dev"] for entry in packages.values())
