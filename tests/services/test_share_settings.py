"""Settings of a share: what is refused by name, and which stores it does not go on with."""

import pytest

from ogm_core.errors import BadInput, BadSetting
from ogm_core.lattice import Clip
from ogm_services.mapper.gateway.gateway_service import run_gateway
from ogm_services.mapper.service import MapperService, run_mapper
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings

MAP = {"resolution": 0.1, "reach": 5.0}


def settings(cuts_x=(0.0,), cuts_y=(), index=0, **sections):
    shares = {"cuts_x": list(cuts_x), "cuts_y": list(cuts_y), "index": index}
    sections = {"map": MAP, "network": {"listen": ["tcp/127.0.0.1:0"]}, "http": {"port": 0}} | sections
    return Settings.model_validate({"shares": shares, **sections})


@pytest.mark.parametrize(
    ("environment", "cuts"),
    [("0", (0.0,)), ("-6.4, 12.8", (-6.4, 12.8)), ("", ())],
)
def test_cuts_are_numbers_with_commas_between(environment, cuts):
    environ = {"OGM_SHARES__CUTS_X": environment, "OGM_MAP__RESOLUTION": "0.1", "OGM_MAP__REACH": "5"}
    assert load_settings(config=None, flags={}, environ=environ).shares.cuts_x == cuts
    with pytest.raises(
        BadSetting, match=r"^shares.cuts_x: a number is needed, got 'nan' \(environment OGM_SHARES__CUTS_X\)$"
    ):
        load_settings(config=None, flags={}, environ=environ | {"OGM_SHARES__CUTS_X": "nan"})
    with pytest.raises(BadSetting, match=r"^shares.cuts_y: a number is needed, got 'x'"):
        load_settings(config=None, flags={}, environ=environ | {"OGM_SHARES__CUTS_Y": "1,x"})


def test_a_share_keeps_its_rectangle_and_only_a_mapper_has_one():
    made = settings(cuts_y=(6.4,), index=3)
    assert made.mapper_grid_settings().clip == Clip(xmin=0, ymin=64)
    assert made.grid_settings().clip is None
    assert Settings().mapper_grid_settings() == Settings().grid_settings()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"index": 2}, r"^shares.index: 2: .* shares 0 to 1$"),
        ({"cuts_x": (0.1,)}, r"^shares.cuts_x: 0.1 m is no edge of tiles .* nearest are 0 and 6.4$"),
        ({"cuts_x": (6.4, 0.0)}, r"^shares.cuts_x: 0 comes after 6.4"),
        ({"map": {"resolution": 0.1}}, r"^map.reach: a map that is cut .* needs one"),
        ({"map": MAP | {"bounds": [0, 0, 6.4, 6.4]}}, r"^shares.cuts_x: 0 m lies outside map.bounds"),
        ({"mapper": {"start_map": __file__}}, r"^mapper.start_map: a map that is cut begins empty"),
    ],
)
def test_what_a_share_cannot_be_is_refused_by_name(given, said):
    with pytest.raises(BadSetting, match=said):
        settings(**given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"cuts_x": (0.1,)}, r"^shares.cuts_x: 0.1 m is no edge of tiles .* nearest are 0 and 6.4$"),
        ({"map": {"resolution": 0.1}}, r"^map.reach: a map that is cut .* needs one.* give --reach$"),
        ({"map": MAP | {"bounds": [0, 0, 6.4, 6.4]}}, r"^shares.cuts_x: 0 m lies outside map.bounds"),
        ({"mapper": {"start_map": __file__}}, r"^mapper.start_map: a map that is cut begins empty"),
        (
            {"map": MAP | {"cell_model": "rate"}, "mapper": {"separate_robots": True}},
            r"^mapper.separate_robots: a map that is cut does not keep",
        ),
    ],
)
def test_a_gateway_refuses_before_it_connects_what_a_share_cannot_be(given, said):
    alone = settings(index=None, network={"connect": ["tcp/127.0.0.1:1"]}, **given)
    with pytest.raises(BadSetting, match=said):
        run_gateway(alone)


def test_a_mapper_of_a_map_that_is_cut_says_which_share_it_keeps():
    with pytest.raises(BadSetting, match=r"^shares.index: this map is cut into 2 shares: say which"):
        MapperService(settings(index=None))


def test_a_share_writes_no_files_of_a_map(tmp_path):
    with pytest.raises(BadInput, match=r"^--out: a share has but a part of the map"):
        run_mapper(settings(), tmp_path)


def test_one_share_is_the_whole_map():
    whole = settings(cuts_x=(), index=0, map={"resolution": 0.1})
    assert whole.mapper_grid_settings().clip == Clip()


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"index": 1}, r"shares.index is 1, and there 0"),
        ({"cuts_x": (0.0, 64.0)}, r"shares.cuts_x is \[0.0, 64.0\], and there \[0.0\]"),
        ({"cuts_y": (6.4,)}, r"shares.cuts_y is \[6.4\], and there \[\]"),
        ({"map": MAP | {"reach": 6.0}}, r"map.reach is 6.0, and there 5.0"),
        ({"cuts_x": (), "index": None}, r"shares.cuts_x is none, and there \[0.0\]"),
    ],
)
def test_a_store_of_other_cuts_or_another_share_is_refused(tmp_path, other, said):
    data = {"mapper": {"data": tmp_path / "data"}}
    with MapperService(settings(**data)):
        pass
    with pytest.raises(BadSetting, match=said):
        MapperService(settings(**data, **other))
    with MapperService(settings(**data)) as again:
        assert again.parts.kept_map is not None
