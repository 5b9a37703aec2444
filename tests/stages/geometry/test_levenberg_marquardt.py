from wayside.stages.geometry.levenberg_marquardt import Schedule, minimiser


def test_equations_that_cannot_be_solved_leave_the_start():
    minimise = minimiser(lambda *_: 1.0, lambda *_: None, lambda *_: False, plain=True)
    assert minimise(None, "start", "trial", Schedule(50, 1e-7)) == ("start", 1.0, 1)
