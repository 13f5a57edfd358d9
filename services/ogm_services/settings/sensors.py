"""Settings of sensors: what is known of them that their messages do not say, or say wrong."""

from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from ogm_core.placing.sensor_rules import MAX_TIME_OFFSET, Beyond, Deskew, SensorRule
from ogm_core.types import Pose
from ogm_core.wire.messages import MAX_RANGE
from ogm_services.settings.values import Finite, NotNegative, Positive, no_switch, parse_pose

_SWITCHES = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def _switch(value: object) -> object:
    if isinstance(value, str):
        value = _SWITCHES.get(value.lower(), value)
    if value is not None and not isinstance(value, bool):
        raise ValueError("true or false is needed")
    return value


def _deskew(value: object) -> object:
    """The choice; what only turns it on or off, as YAML reads a plain `off`, means the nearest one."""
    if isinstance(value, str):
        value = _SWITCHES.get(value.lower(), value.lower())
    return {True: "auto", False: "off"}[value] if isinstance(value, bool) else value


def _of_source(glob: str) -> str:
    if "/" not in glob and not glob.endswith("*"):
        raise ValueError("the name of a robot's sensor is needed, such as r1/laser or */laser")
    return glob


Switch = Annotated[bool | None, BeforeValidator(_switch)]
Range = Annotated[NotNegative, Field(le=MAX_RANGE), BeforeValidator(no_switch)]
Offset = Annotated[Finite, Field(ge=-MAX_TIME_OFFSET, le=MAX_TIME_OFFSET), BeforeValidator(no_switch)]
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
    reach: Annotated[Positive | None, BeforeValidator(no_switch)] = None
    ignore_no_return: Switch = None
    deskew: Annotated[Deskew | None, BeforeValidator(_deskew)] = None
    mount: Mount | None = None
    upside_down: Switch = None

    @model_validator(mode="after")
    def _ranges_agree(self) -> Self:
        if self.range_min is not None and self.range_max is not None and self.range_min >= self.range_max:
            raise ValueError(
                f"range_min: it must be below range_max, got {self.range_min:g} and {self.range_max:g}"
            )
        return self

    def rule(self) -> SensorRule:
        """The same as the mapper knows it."""
        return SensorRule(**{name: getattr(self, name) for name in type(self).model_fields})
