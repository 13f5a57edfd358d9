"""Settings of every service: what may be set, and within which limits."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self, assert_never

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FilePath,
    model_validator,
)

from ogm_core.cells.forgetting import MAX_HALF_LIFE, MIN_HALF_LIFE
from ogm_core.cells.log_odds import CellType, LogOdds
from ogm_core.cells.model import CellModel
from ogm_core.cells.rate import Rate
from ogm_core.cells.thresholds import FREE_BELOW
from ogm_core.errors import BadSetting
from ogm_core.files.strict_yaml import dump_yaml
from ogm_core.grid_settings import (
    DEFAULT_MAX_BYTES,
    DEFAULT_MAX_CELLS,
    DEFAULT_MAX_SCAN_CELLS,
    CellModelName,
    GridSettings,
    Outside,
    SensorModel,
    Traversal,
)
from ogm_core.lattice import MAX_RESOLUTION, MIN_RESOLUTION
from ogm_core.placing.robot_rules import RobotRule
from ogm_core.placing.rules import DEFAULT_RULES, PlacingRules
from ogm_core.placing.sensor_rules import SensorRule
from ogm_core.shares import Share
from ogm_core.wire.keys import DEFAULT_ADDRESS, check_name
from ogm_services.runtime.cores import usable_cores
from ogm_services.settings.http import SECRETS, HttpSettings
from ogm_services.settings.robots import RobotSettings
from ogm_services.settings.section import Section
from ogm_services.settings.sensors import SensorSettings
from ogm_services.settings.shares import SharesSettings
from ogm_services.settings.values import (
    LOWER_CASE,
    NONE,
    OF_LOG_ODDS,
    Bounds,
    Count,
    Endpoints,
    Finite,
    Folder,
    FreeBelow,
    LogFormat,
    LogLevel,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Preset,
    Probability,
    Threads,
    WholeNumber,
)

DEFAULT_MAX_MEMORY = 3 * DEFAULT_MAX_BYTES
"""The largest map, a copy for readers, which takes up to a quarter more, and over 1 GiB for all else."""
MIN_MEMORY = 2**24
"""Less than this leaves no room for a map, bytes."""

if TYPE_CHECKING:
    from ogm_client.session import NetworkConfig


class MapSettings(Section):
    """The map and its sensor model; lengths in metres. Text "none" means none where none is allowed."""

    preset: Annotated[Preset | None, NONE] = None
    resolution: Annotated[Finite, Field(ge=MIN_RESOLUTION, le=MAX_RESOLUTION)] = 0.05
    p_prior: Probability = 0.5
    p_occ: Probability = 0.7
    p_free: Probability = 0.3
    l_min: Finite = -8.0
    l_max: Finite = 8.0
    alpha: NotNegative = 0.1
    sensor_model: SensorModel = "beam"
    cell_model: CellModelName = "log_odds"
    traversal: Traversal = "bresenham"
    reach: Annotated[Positive | None, NONE] = None
    clear_range: Annotated[NotNegative | None, NONE] = None
    cells: CellType = "int16"
    bounds: Annotated[Bounds | None, NONE] = None
    outside: Outside = "clip"
    free_below: FreeBelow = FREE_BELOW
    half_life: Annotated[Annotated[Finite, Field(ge=MIN_HALF_LIFE, le=MAX_HALF_LIFE)] | None, NONE] = None

    def made_cell_model(self) -> CellModel:
        """The cell model of this name, with its parameters.

        Raises:
            BadSetting: probabilities and clamps contradict each other, or are given to a model without.
        """
        if self.cell_model == "rate":
            given = [f"map.{name}" for name in OF_LOG_ODDS if name in self.model_fields_set]
            if given:
                raise BadSetting(
                    f"{', '.join(given)}: cell model rate counts and has no log odds, increments, clamps or "
                    "traversal: leave it out, or give map.cell_model log_odds"
                )
            return Rate(free_below=self.free_below)
        if self.cell_model != "log_odds":
            assert_never(self.cell_model)
        clamps = self.l_min, self.l_max
        return LogOdds(self.cells, self.p_prior, self.p_occ, self.p_free, *clamps, self.free_below)


class NetworkSettings(Section):
    """The map's name, and the way to the other services.

    A relative `zenoh_config` starts at the working folder.
    """

    map_name: Annotated[str, AfterValidator(lambda name: check_name(name, "network.map_name"))] = "default"
    listen: Endpoints = ()
    connect: Endpoints = ()
    zenoh_config: Annotated[FilePath | None, NONE] = None

    def for_mapper(self) -> "NetworkConfig":
        """How a mapper opens its session: as told, else it listens on loopback."""
        return replace(self._config(listen=(DEFAULT_ADDRESS,), connect=()), serves=True)

    def for_client(self) -> "NetworkConfig":
        """How everyone else opens a session: as told, else connected to the mapper on loopback."""
        return self._config(listen=(), connect=(DEFAULT_ADDRESS,))

    def _config(self, *, listen: tuple[str, ...], connect: tuple[str, ...]) -> "NetworkConfig":
        from ogm_client.session import NetworkConfig

        if self.listen or self.connect or self.zenoh_config:
            listen, connect = self.listen, self.connect
        return NetworkConfig(listen=listen, connect=connect, config_file=self.zenoh_config)


class MapperSettings(Section):
    """The mapper's limits, and what its map starts with.

    `max_cells` of the known rectangle, `max_bytes` of the map's own memory, `max_memory` of all that robots
    and readers make it hold, `max_beams` and
    `max_scan_cells` of one scan, `queue` in scans, `threads` that update the cells of a large scan.
    `pose_wait` and `pose_gap` in s, `max_speed` in m/s, `max_turn_rate` in rad/s: see
    `PlacingRules`. With `separate_robots` one can be left out of the map later. `data` is the folder that the
    map is stored in, made if need be; `start_map` the YAML file of a ROS map, or a map.npz; a relative path
    starts at the working folder; `start_confidence` the probability that a ROS map's occupied cells are
    occupied, and its free ones free.
    """

    max_cells: Count = DEFAULT_MAX_CELLS
    max_bytes: Count = DEFAULT_MAX_BYTES
    max_memory: Annotated[WholeNumber, Field(ge=MIN_MEMORY)] = DEFAULT_MAX_MEMORY
    max_beams: Count = 200_000
    max_scan_cells: Count = DEFAULT_MAX_SCAN_CELLS
    pose_wait: NotNegative = DEFAULT_RULES.pose_wait
    pose_gap: Positive = DEFAULT_RULES.pose_gap
    max_speed: PositiveOrInfinite = DEFAULT_RULES.max_speed
    max_turn_rate: PositiveOrInfinite = DEFAULT_RULES.max_turn_rate
    queue: Count = 4096
    threads: Threads = 1
    separate_robots: bool = False
    data: Annotated[Folder | None, NONE] = None
    start_map: Annotated[FilePath | None, NONE] = None
    start_confidence: Annotated[Finite, Field(gt=0.5, lt=1.0)] = 0.9

    @property
    def thread_count(self) -> int:
        """How many threads update the cells of a large scan: with `auto` one less than there are cores.

        Only the cores count that this process may use. It is one at least.
        """
        if isinstance(self.threads, int):
            return self.threads
        return max(1, usable_cores() - 1)


class LogSettings(Section):
    """What a service logs, and in which form."""

    level: Annotated[LogLevel, LOWER_CASE] = "info"
    format: Annotated[LogFormat, LOWER_CASE] = "text"

    @property
    def as_given(self) -> tuple[LogLevel, LogFormat]:
        """Both."""
        return self.level, self.format


class Settings(BaseModel):
    """All settings of a service, checked against each other.

    Raises:
        BadSetting: map settings contradict each other.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    map: MapSettings = Field(default_factory=MapSettings)
    network: NetworkSettings = Field(default_factory=NetworkSettings)
    http: HttpSettings = Field(default_factory=HttpSettings)
    mapper: MapperSettings = Field(default_factory=MapperSettings)
    shares: SharesSettings = Field(default_factory=SharesSettings)
    log: LogSettings = Field(default_factory=LogSettings)
    sensors: tuple[SensorSettings, ...] = ()
    robots: tuple[RobotSettings, ...] = ()

    @model_validator(mode="after")
    def _agree(self) -> Self:
        self.grid_settings()
        start_map = self.mapper.start_map
        if self.map.bounds is not None and start_map is not None and not is_npz(start_map):
            raise BadSetting(
                "map.bounds: a map that starts with mapper.start_map has no bounds; leave out one of the two"
            )
        if self.shares.index is not None:
            self.check_cut()
        return self

    def check_cut(self) -> None:
        """Refuse, with BadSetting, what a map that is cut into shares cannot have, whoever serves it."""
        share = Share(self.shares.cuts, self.shares.index or 0)
        if self.mapper.start_map is not None:
            raise BadSetting("mapper.start_map: a map that is cut begins empty: leave it out")
        share.cuts.check(self.grid_settings().lattice, self.map.bounds)
        if share.cuts.count > 1 and self.map.reach is None:
            raise BadSetting(
                "map.reach: a map that is cut (shares.cuts_x, shares.cuts_y) needs one, so that it is known "
                "how far scans reach into other shares: give --reach"
            )
        replace(self.grid_settings(), share=share)

    def grid_settings(self) -> GridSettings:
        """What the map is made of."""
        return GridSettings(
            resolution=self.map.resolution,
            cell_model=self.map.made_cell_model(),
            sensor_model=self.map.sensor_model,
            traversal=self.map.traversal,
            alpha=self.map.alpha,
            reach=self.map.reach,
            clear_range=self.map.clear_range,
            bounds=self.map.bounds,
            outside=self.map.outside,
            half_life=self.map.half_life,
            separate_robots=self.mapper.separate_robots,
            max_cells=self.mapper.max_cells,
            max_bytes=self.mapper.max_bytes,
            max_scan_cells=self.mapper.max_scan_cells,
        )

    def mapper_grid_settings(self) -> GridSettings:
        """The same of the mapper of one share: it keeps that share's cells alone."""
        return replace(self.grid_settings(), share=self.shares.of_mapper())

    def placing_rules(self) -> PlacingRules:
        """What is believed of poses and scans."""
        limits = self.mapper
        return PlacingRules(limits.pose_gap, limits.pose_wait, limits.max_speed, limits.max_turn_rate)

    def sensor_rules(self) -> list[SensorRule]:
        """What is known of the sensors, the first to look at first."""
        return [sensor.rule() for sensor in self.sensors]

    def robot_rules(self) -> list[RobotRule]:
        """What is known of the robots, likewise."""
        return [robot.rule() for robot in self.robots]

    def to_yaml(self, *, secrets: bool = False) -> str:
        """Every setting that was given, as a file from which `load_settings` makes equal settings.

        Without `secrets` the token is masked, and is to be given anew.
        """
        return dump_yaml(self.model_dump(mode="json", exclude_unset=True, context={SECRETS: secrets}))


def is_npz(start_map: Path) -> bool:
    """Whether a map starts with one that was saved as NPZ; else the file describes a ROS map."""
    return start_map.suffix.lower() == ".npz"


SECTIONS: Mapping[str, type[BaseModel]] = {
    "map": MapSettings,
    "network": NetworkSettings,
    "http": HttpSettings,
    "mapper": MapperSettings,
    "shares": SharesSettings,
    "log": LogSettings,
}
"""The sections of `Settings` that hold settings, by name."""
LISTS: Mapping[str, type[BaseModel]] = {"sensors": SensorSettings, "robots": RobotSettings}
"""Those that are lists of mappings."""
