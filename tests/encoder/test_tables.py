"""Files of a package are numbered once."""

from airgs_codec.encoder.tables import number_units


def test_files_count_from_one_within_their_representation():
    present = [[True, False], [False, False], [True, True]]
    assert number_units(present) == [[1, 0], [0, 0], [2, 1]]
