"""Rooms of stages are entered by their front door."""

import grimp


def test_code_outside_a_room_imports_from_its_front_door_only():
    graph = grimp.build_graph("wayside")
    inside = [
        name for name in graph.modules if name.startswith("wayside.stages.") and name.count(".") > 2
    ]
    past_the_door = [
        (importer, name)
        for name in inside
        for importer in graph.find_modules_that_directly_import(name)
        if not importer.startswith(name.rpartition(".")[0])
    ]
    assert len(inside) > 80
    assert not past_the_door
