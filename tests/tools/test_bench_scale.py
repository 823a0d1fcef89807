"""The benchmark of scale: what it fits, and where it writes what it found."""

import csv

import pytest

from tools.bench_scale import CSV_NAME, HEADING, PAGE_NAME, Measured, fit_power, fit_words, main, write_section


def test_a_power_law_is_found_again():
    a, k = fit_power([10, 100, 1000], [3 * size**1.25 for size in (10, 100, 1000)])
    assert (a, k) == (pytest.approx(3), pytest.approx(1.25))
    assert fit_words([(10, 1.0), (100, 10.0)]) == "exponent 1.00, 10 to 100"
    assert fit_words([(10, 1.0)]) == "not measured"


def test_every_step_of_every_scene_is_measured(tmp_path):
    main(["-o", str(tmp_path), "--rows", "300", "--frames", "2,40", "--few", "200"])
    with (tmp_path / CSV_NAME).open() as file:
        rows = list(csv.DictReader(file))
    scenes = [("300", "2"), ("200", "2"), ("200", "40")]
    assert [(row["rows"], row["frames"], row["step"]) for row in rows] == [
        (*scene, step) for scene in scenes for step in ("cold", "warm", "decode")
    ]
    assert all(float(row["cpu_seconds"]) > 0 and float(row["peak_mb"]) > 10 for row in rows)
    assert len({(row["rows"], row["frames"], row["frame_bytes"]) for row in rows}) == len(scenes)
    text = (tmp_path / PAGE_NAME).read_text()
    assert text.startswith(f"# Scale\n\n{HEADING}\n") and text.count("| cold |") == len(scenes) + 1


def test_the_section_takes_the_place_of_the_one_before(tmp_path):
    page = tmp_path / PAGE_NAME
    page.write_text(f"# Scale\n\n## First\n\nkept\n\n{HEADING}\n\nreplaced\n\n## Last\n\nkept\n")
    found = [Measured(rows, 2, "cold", rows / 10, rows / 10, 100.0, 50.0) for rows in (100, 1000)]
    write_section(found, 20, "a command", page)
    text = page.read_text()
    assert "replaced" not in text and text.count(HEADING) == 1
    assert text.startswith("# Scale\n\n## First\n\nkept\n\n## ") and text.endswith("\n\n## Last\n\nkept\n")
    assert "| cold | exponent 1.00, 100 to 1,000 | not measured |" in text
