import pytest

from wayside.pipeline.labels.class_map import EXAMPLE, numbered, read_class_map
from wayside.schemas.detectors import SignClass
from wayside.schemas.errors import InputError

NAMES = {0: "person", 11: "stop sign", 12: "parking meter"}


def written(folder, text):
    path = folder / "classes.toml"
    path.write_text(text)
    return path


def test_classes_are_named_or_numbered_and_say_as_much_as_they_know(tmp_path):
    text = '[classes]\n"stop sign" = { color = "red" }\n12 = {}\n[classes.0]\nshape = "other"\n'
    example = read_class_map(written(tmp_path, EXAMPLE))  # that the messages show
    assert example == {"stop sign": SignClass("red", "octagon")}
    classes = read_class_map(written(tmp_path, text))
    wanted = {11: SignClass("red", None), 12: SignClass(), 0: SignClass(None, "other")}
    assert numbered(classes, NAMES, "a.onnx", complete=True) == wanted


def test_a_name_that_the_detector_does_not_have_is_refused_with_the_nearest(tmp_path):
    classes = read_class_map(written(tmp_path, '[classes]\n"stop_sign" = {}\n'))
    with pytest.raises(InputError, match=r"no class 'stop_sign'; .* did you mean 'stop sign'\?"):
        numbered(classes, NAMES, "a.onnx", complete=True)
    assert numbered(classes, NAMES, "boxes.parquet", complete=False) == {}


def test_a_detector_without_names_wants_numbers(tmp_path):
    classes = read_class_map(written(tmp_path, '[classes]\n"stop sign" = {}\n7 = {}\n'))
    with pytest.raises(InputError, match=r"does not name its classes.*'stop sign'"):
        numbered(classes, {}, "a.onnx", complete=True)
    assert numbered({"7": SignClass()}, {}, "a.onnx", complete=True) == {7: SignClass()}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must hold one table"),
        ("[classes]\n", "holds no class"),
        ("[class]\nstop = {}\n", "holds class"),
        ("[classes]\nstop = {}\n[more]\n", "holds more"),
        ('[classes]\nstop = "red"\n', "is 'red'"),
        ('[classes]\nstop = { colour = "red" }\n', "colour"),
        ('[classes]\nstop = { color = "purple" }\n', "'purple', .* one of white, yellow"),
        ('[classes]\nstop = { shape = "heart" }\n', "'heart', .* one of rectangle"),
        ("[classes\n", "not valid TOML"),
    ],
)
def test_what_is_no_class_map_is_refused_with_words(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_class_map(written(tmp_path, text))
    with pytest.raises(InputError, match=r"models\.classes: the class map at .* cannot be read"):
        read_class_map(tmp_path / "none.toml")
