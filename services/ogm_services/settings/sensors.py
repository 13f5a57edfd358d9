"""Settings of sensors: what is known of them that their messages do not say, or say wrong."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ogm_core.errors import BadSetting
from ogm_core.placing.sensor_rules import MAX_TIME_OFFSET, Beyond, SensorRule
from ogm_core.types import Pose
from ogm_core.wire.messages import MAX_RANGE
from ogm_services.settings.values import Finite, NotNegative, Positive, did_you_mean, parse_pose

FORM = "GLOB:KEY=VALUE,..."
_SWITCHES = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def _switch(value: object) -> object:
    if isinstance(value, str):
        value = _SWITCHES.get(value.lower(), value)
    if value is not None and not isinstance(value, bool):
        raise ValueError("true or false is needed")
    return value


def _number(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("a number is needed")  # noqa: TRY004 (pydantic collects ValueErrors only)
    return value


def _of_source(glob: str) -> str:
    if "/" not in glob and not glob.endswith("*"):
        raise ValueError("the name of a robot's sensor is needed, such as r1/laser or */laser")
    return glob


Switch = Annotated[bool | None, BeforeValidator(_switch)]
Range = Annotated[NotNegative, Field(le=MAX_RANGE), BeforeValidator(_number)]
Offset = Annotated[Finite, Field(ge=-MAX_TIME_OFFSET, le=MAX_TIME_OFFSET), BeforeValidator(_number)]
Mount = Annotated[Pose, BeforeValidator(parse_pose)]


class SensorSettings(BaseModel):
    """One entry of the section `sensors`: see `SensorRule`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    match: Annotated[str, AfterValidator(_of_source)]
    time_offset: Offset | None = None
    range_min: Range | None = None
    range_max: Range | None = None
    beyond: Beyond | None = None
    clear_range: Range | None = None
    reach: Annotated[Positive | None, BeforeValidator(_number)] = None
    ignore_no_return: Switch = None
    deskew: Switch = None
    mount: Mount | None = None
    upside_down: Switch = None

    def rule(self) -> SensorRule:
        """The same as the mapper knows it."""
        return SensorRule(**{name: getattr(self, name) for name in type(self).model_fields})


def read_entry(entry: object, source: str) -> SensorSettings:
    """One entry, as YAML gives it or `parse_entry`; `source` is how the user knows where it stands.

    Raises:
        BadSetting: a key is unknown, or a value not allowed.
    """
    if not isinstance(entry, Mapping):
        raise BadSetting(f"sensors: mappings with the key match are needed, got {entry!r:.60} ({source})")
    for key in map(str, entry):
        if key not in SensorSettings.model_fields:
            meant = did_you_mean(key, SensorSettings.model_fields)
            raise BadSetting(f"sensors.{key}: unknown setting{meant} ({source})")
    try:
        made = SensorSettings.model_validate(dict(entry))
    except ValidationError as error:
        problem = error.errors()[0]
        key = str(problem["loc"][0])
        said = problem["msg"].removeprefix("Value error, ")
        given = f", got {entry[key]!r}" if key in entry else ""
        raise BadSetting(f"sensors.{key}: {said[0].lower()}{said[1:]}{given} ({source})") from None
    if made.range_min is not None and made.range_max is not None and made.range_min >= made.range_max:
        both = f"{made.range_min:g} and {made.range_max:g}"
        raise BadSetting(f"sensors.range_min: it must be below range_max, got {both} ({source})")
    return made


def parse_entry(text: str, source: str) -> Mapping[str, Any]:
    """One entry from the text GLOB:KEY=VALUE,...; values may hold commas.

    Raises:
        BadSetting: it is of another form.
    """
    glob, colon, rest = text.partition(":")
    entry: dict[str, Any] = {"match": glob.strip()}
    key = ""
    for part in rest.split(","):
        name, equals, value = part.partition("=")
        if equals:
            key = name.strip()
            if key in entry:
                raise BadSetting(f"sensors.{key}: given twice in {text!r} ({source})")
            entry[key] = value.strip()
        elif key:
            entry[key] += f",{part.strip()}"
        else:
            colon = ""
    if not (colon and entry["match"] and len(entry) > 1):
        raise BadSetting(f"sensors: {FORM} is needed, got {text!r} ({source})")
    return entry
