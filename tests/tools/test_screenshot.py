"""A picture of the player is taken where everything for it is there; elsewhere the tool says what is missing."""

import sys

from tests.support.paths import VALID
from tools import screenshot


def test_it_says_what_is_missing_and_the_browser_gets_the_address_of_the_package(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sys, "argv", ["screenshot", str(VALID / "moving"), "-o", str(tmp_path / "a.png")])
    with monkeypatch.context() as patch:
        patch.setattr(screenshot.shutil, "which", lambda name: None)
        assert screenshot.main() == 0
    out = capsys.readouterr().out
    assert "chromium" in out and "node" in out and out.count("\n") == 1
    monkeypatch.setattr(screenshot, "missing", list)
    node = tmp_path / "node"
    node.write_text(f"#!{sys.executable}\nimport sys\nopen(sys.argv[3], 'w').write(sys.argv[2])\nsys.exit(2)\n")
    node.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert screenshot.main() == 2
    address = (tmp_path / "a.png").read_text()
    assert address.startswith("http://127.0.0.1:") and address.endswith("/player.html?src=moving/")
