"""The gallery: its script finds a file for every picture of the page, and the pictures are small."""

from benchmarks import gallery

SECTIONS = gallery.sections(gallery.PAGE.read_text(encoding="utf-8"))


def test_every_picture_of_the_page_exists_and_has_a_file_of_a_command():
    pictures = [picture for section in SECTIONS for picture in section.pictures]
    assert len(pictures) >= 12 and all((gallery.FIGURES / picture).is_file() for picture in pictures)
    for section in SECTIONS:
        assert len(section.pictures) == len(section.files) and section.commands


def test_the_gallery_s_own_pictures_are_smaller_than_3_mb_and_all_on_the_page():
    own = list((gallery.FIGURES / "gallery").iterdir())
    assert sum(file.stat().st_size for file in own) < 3e6
    assert {f"gallery/{file.name}" for file in own} <= {picture for each in SECTIONS for picture in each.pictures}
