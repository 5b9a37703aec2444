from wayside.schemas.settings import AssemblySettings, MappingSettings
from wayside.stages.mapping.assembly import assemble, same_support
from wayside.stages.mapping.tracker import track

SETTINGS = AssemblySettings()


def assembled(frames):
    return list(assemble(track(iter(frames), MappingSettings()), SETTINGS))


def landmarks_of(tracked):
    return [place for item in tracked for place in item.landmarks]


def test_panels_of_one_post_share_a_number_and_others_do_not(panel, drive):
    signs = [panel(3.5, 2.0, 120.0), panel(3.5, 1.2, 120.0), panel(-3.5, 1.2, 120.0)]
    by_side = {}
    for place in landmarks_of(assembled(drive(signs, 20))):
        by_side.setdefault(place.right_m > 0, set()).add(place.assembly)
    assert len(by_side[True]) == 1
    assert len(by_side[False]) == 1
    assert by_side[True] != by_side[False]


def test_posts_one_behind_the_other_are_two_supports(panel, drive):
    signs = [panel(3.5, 1.2, 120.0), panel(3.5, 1.2, 140.0)]
    numbers = [place.assembly for place in landmarks_of(assembled(drive(signs, 22)))]
    assert sorted(numbers) == [0, 1]


def test_a_plaque_hangs_on_the_support_of_the_sign_above(panel, drive):
    signs = [panel(3.5, 2.0, 120.0), panel(3.5, 1.4, 120.0, wide=0.6, tall=0.3)]
    one, other = landmarks_of(assembled(drive(signs, 20)))
    assert same_support(one, other, SETTINGS)
    assert {one.verdict, other.verdict} == {"sign"}
