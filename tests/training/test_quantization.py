"""Networks in whole numbers: nearly the same output as in floating point, and the same again when rewritten."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from training import quantization
from training.quantization import _two_digits, rewrite
from wayside.pipeline.models.model_files import onnx_metadata
from wayside.stages.classifiers import OnnxNetwork
from wayside.stages.detection import DetectionNetwork, log_levels


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two networks that were never trained, with what they see: files as they were quantised, and rewritten ones."""
    torch = pytest.importorskip("torch", reason="PyTorch is only needed for learning")
    onnx = pytest.importorskip("onnx", reason="onnx is only needed for learning: make .venv/.learn")
    from training import networks

    torch.manual_seed(1)
    rng = np.random.default_rng(1)
    folder = tmp_path_factory.mktemp("networks")
    images = [rng.integers(0, 256, (64, 96, 3)).astype(np.uint8) for _ in range(2)]
    patches = log_levels(rng.integers(0, 256, (5, 48, 48, 3)).astype(np.uint8))
    sizes = rng.uniform(8, 90, (5, 2)).astype(np.float32)
    names = "network", "box"
    network, boxes = networks.DetectionNetwork(), networks.BoxNetwork()
    # statistics of the normalisations: without them all biases are one
    network(torch.from_numpy(np.stack(images)))
    boxes(torch.from_numpy(patches), torch.from_numpy(sizes))
    with pytest.warns():
        network.write(folder / "network", {"sources": "demo: 3 images"})
    with pytest.warns():
        boxes.write(folder / "box", {"sources": "demo: 3 images"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quantization, "rewrite", lambda graph: None)
        quantization.quantize(folder / "network", folder / "network_plain", images)
        samples = [{"patch": patches, "size": sizes}]
        quantization.quantize_boxes(folder / "box", folder / "box_plain", samples)
    for name in names:
        model = onnx.load(str(folder / f"{name}_plain"))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(quantization, "_split_last_layer", lambda graph: None)
            rewrite(model.graph)
        onnx.checker.check_model(model, full_check=True)
        onnx.save(model, str(folder / f"{name}_rewritten"))
    rewrite(model.graph)  # the box network has no such layer
    assert model.SerializeToString() == (folder / "box_rewritten").read_bytes()
    seen = {"image": images[0][None]}, {"patches": patches, "sizes": sizes}
    return {
        name: (folder / f"{name}_plain", folder / f"{name}_rewritten", feed, output)
        for name, feed, output in zip(names, seen, ("maps", "boxes"), strict=True)
    }


@pytest.fixture
def split(files, tmp_path):
    """The detection network with its last layer split, as a file."""
    import onnx

    model = onnx.load(str(files["network"][0]))
    rewrite(model.graph)
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, str(tmp_path / "split"))
    return tmp_path / "split"


@pytest.mark.parametrize("name", ["network", "box"])
def test_a_rewritten_network_says_the_same(files, name):
    plain, rewritten, feed, output = files[name]
    one, other = (OnnxNetwork(str(path), (output,)).run(feed)[output] for path in files[name][:2])
    assert plain.read_bytes() != rewritten.read_bytes()
    assert np.ptp(one) > 0
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("name", "off", "share"), [("network", 0.1, 0.4), ("box", 0.15, 0.8)])
def test_whole_numbers_give_nearly_the_same_in_a_small_file_that_says_where_it_is_from(
    files, name, off, share
):
    plain, _, feed, output = files[name]
    whole = plain.with_name(name)
    one, other = (OnnxNetwork(str(path), (output,)).run(feed)[output] for path in (whole, plain))
    assert np.abs(one - other).max() > 0
    assert np.std(one - other) < off * np.std(one)
    assert plain.stat().st_size < share * whole.stat().st_size
    said = onnx_metadata(plain.read_bytes())
    assert said["sources"] == "demo: 3 images"
    assert "7 bits" in said["weights"]


def test_all_that_can_be_rewritten_is(files):
    import onnx

    graphs = [onnx.load(str(path)).graph for path in files["network"][:2]]
    plain, rewritten = ([node.op_type for node in graph.node] for graph in graphs)
    for kind in ("Div", "Resize"):
        assert kind in plain
        assert kind not in rewritten
    assert rewritten.count("Conv") == plain.count("Conv")


@pytest.mark.parametrize("name", ["network", "box"])
def test_nothing_that_is_not_used_is_left(files, name):
    graph = pytest.importorskip("onnx").load(str(files[name][1])).graph
    used = {one.name for one in graph.output}.union(*(node.input for node in graph.node))
    assert {one.name for one in graph.initializer} <= used
    assert not [node for node in graph.node if used.isdisjoint(node.output)]


def test_a_split_last_layer_makes_the_same_of_every_cell(files, split):
    plain, _, feed, _ = files["network"]
    one, other = (
        DetectionNetwork(str(path)).maps(feed["image"][0]).all() for path in (plain, split)
    )
    assert np.ptp(one) > 0.1
    np.testing.assert_allclose(other[:2], one[:2], atol=1e-3)
    np.testing.assert_allclose(other[2:], one[2:], atol=1e-5)


@given(
    arrays(np.float32, (2, 7), elements=st.floats(-8, 8, width=32)).filter(
        lambda weight: (np.abs(weight).max(axis=1) > 1e-3).all()
    )
)
def test_two_digits_of_seven_bits_make_a_weight(weight):
    digits, joins = _two_digits(weight)
    assert -64 <= digits.min() <= digits.max() <= 63
    largest = np.abs(weight).max(axis=1)
    assert (np.abs((digits @ joins).T - weight).max(axis=1) <= largest / 16_000).all()


def test_a_network_is_rewritten_once(split):
    import onnx

    model = onnx.load(str(split))
    before = model.SerializeToString()
    rewrite(model.graph)
    assert model.SerializeToString() == before
