"""A sample of mutants; `python -m tests.long files` tries a hundred thousand."""

from tests.long.fuzz import TARGETS, Tally


def test_mutants_are_read_or_refused():
    tally = Tally()
    tally.run(200, 650)
    assert tally.findings == {}
    assert tally.counts.keys() == {target.name for target in TARGETS}
    assert {"read", "bad_value", "wrong_type", "bad_sidecar", "bad_picture", "hash_mismatch"} <= {
        *tally.counts["package"]
    }
    assert all({"read", "SceneError"} <= {*tally.counts[name]} for name in (".ply", ".glb", ".splatv", "cameras"))
