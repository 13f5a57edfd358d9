"""Section of the settings: what its groups have in common."""

from pydantic import BaseModel, ConfigDict, field_validator


class Section(BaseModel):
    """A group of settings: frozen, closed to unknown keys; text is read as what each key needs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @field_validator("*", mode="before")
    @classmethod
    def _no_setting_is_a_switch(cls, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError("this is not a switch")  # noqa: TRY004 (pydantic collects ValueErrors only)
        return value
