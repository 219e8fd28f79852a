"""Errors and warnings, one function each, which returns it with its code, message and remedy.

Made from errors.toml by `python -m tools.generate`; edit that file.
"""

from __future__ import annotations

from enum import StrEnum

from edmctl.errors import (
    Diagnostic,
    LinkLost,
    MachineFault,
    ObjectiveNotReached,
    PreconditionError,
    ProtocolMismatch,
    RecordError,
    RunFileError,
    UsageError,
)


class Code(StrEnum):
    """A rule that a profile, setup or study violates."""

    SYNTAX = "E3001"
    MISSING_KEY = "E3002"
    UNKNOWN_KEY = "E3003"
    WRONG_TYPE = "E3004"
    OUT_OF_RANGE = "E3005"
    NOT_A_CHOICE = "E3006"
    EXTENDS = "E3007"
    SCHEMA_VERSION = "E3008"
    OVERRIDE = "E3009"
    UNREADABLE = "E3010"
    NOT_A_MULTIPLE = "E3011"
    PLACES_FILE = "E3012"
    STUDY = "E3013"
    REFERENCE_WINDOW = "E3101"
    STROKE = "E3102"
    SLOPE_BELOW_FEED = "E3103"
    LIMIT_CYCLE = "E3104"
    RAMP_ORDER = "E3105"
    OFFSET = "E3106"
    JUMP = "E3107"
    PULSE_TIMES = "E3109"
    THROUGH_STROKE = "E3110"
    TOLERANCE = "E3111"
    FILTER = "E3113"
    FEED_REMEASURE = "E3114"
    DISCHARGE_TIME = "E3115"
    REFERENCE_ONCE = "E3116"
    TOOL_WEAR = "E3117"
    APPROACH_TRAVEL = "E3118"
    BLIND_DEPTH = "E3119"
    ACTUATOR_VOLTAGE = "E3121"
    PAD_DISTANCE = "E3122"
    TARGET_KIND = "E3123"
    ADAPTIVE = "E3124"
    PATH_KEYS = "E3125"
    SITES_OR_PATH = "E3126"
    SITES = "E3127"
    OVERLAP = "E3128"
    REGIMES = "E3137"
    NO_REMOVAL = "E3138"
    OUT_OF_REACH = "E3140"
    SLOPE_NEAR_FEED = "W3103"
    LIMIT_CYCLE_LARGE = "W3104"
    JUMP_TOO_LOW = "W3107"
    PULSE_ENERGY = "W3108"
    TIME_LIMIT = "W3120"
    NOT_THROUGH = "W3123"
    ARRAY_WEAR = "W3129"
    ARRAY_STROKE = "W3130"
    LAYER = "W3131"
    NOT_SHOWN = "W3132"
    LESS_THAN_TOLERANCE = "W3133"
    UNKNOWN_MATERIAL = "W3134"
    SIM_CONTRADICTS = "W3135"
    BEYOND_LAWS = "W3136"
    STATED_CONTRADICTS = "W3139"


def run_id_without_folder(*, run_id: object) -> UsageError:
    return UsageError(
        f"run_id {run_id!r} names a run file, and without `out` there is none.",
        hint="Give out=, the folder of run files, as well.",
        code="E2000",
    )


def count_too_small(*, count: object) -> UsageError:
    return UsageError(
        f"count is {count}, and at least one is needed.", hint="Ask for 1 or more.", code="E2000"
    )


def command_line_wrong(*, message: object, end: object, remedy: object) -> UsageError:
    return UsageError(f"{message}{end}", hint=f"{remedy}", code="E2000")


def waveform_missing() -> UsageError:
    return UsageError(
        "Missing argument 'WAVEFORM'.",
        hint="--model paper alone needs none; `edmctl simulate actuator --help` lists what there is.",
        code="E2000",
    )


def place_not_finite(*, place: object, most_um: float) -> UsageError:
    return UsageError(
        f"{place!r} is no place of the stages.",
        hint=f"Give x and y in µm, within ± {most_um:.0f}.",
        code="E2000",
    )


def no_profile_named() -> UsageError:
    return UsageError(
        "No profile was named.",
        hint="Say --profile NAME|FILE or set EDMCTL_PROFILE; `--profile cu270` takes a shipped one.",
        code="E2002",
    )


def sweep_unreadable(*, text: object, reason: object) -> UsageError:
    return UsageError(
        f"--sweep {text!r}: {reason}.",
        hint="Examples: --sweep servo.reference=0.7:0.9:5, --sweep tool.material=Cu,W",
        code="E2003",
    )


def sweep_key_twice(*, twice: object) -> UsageError:
    return UsageError(f"Two sweeps go over {twice}.", hint="Give each key one --sweep.", code="E2003")


def sweep_too_large(
    *, values: object, runs: object, size: object, most_runs: object, fewer: object
) -> UsageError:
    return UsageError(
        f"{values} with {runs} each are {size} runs; at most {most_runs} go at a time.",
        hint=f"Take {fewer}fewer values.",
        code="E2003",
    )


def resume_not_a_run(*, named: object) -> UsageError:
    return UsageError(
        f"--resume {named} is no run file.",
        hint="Name FILE.h5, its .h5.partial or its .journal, or the run's id, with its folder as --out.",
        code="E2004",
    )


def run_id_not_a_file_name(*, run_id: object) -> UsageError:
    return UsageError(
        f"Run id {run_id!r} is no plain file name.",
        hint="Take up to 120 letters, digits and . _ + - and begin with a letter or digit.",
        code="E2004",
    )


def run_twice(*, again: object) -> UsageError:
    return UsageError(
        f"The run {again} would be made twice, into one file.",
        hint="Give each seed and each value once.",
        code="E2005",
    )


def seed_out_of_range(*, asked: object, largest: object, of_runs: object) -> UsageError:
    return UsageError(
        f"Seed {asked} does not lie between 0 and {largest}{of_runs}.",
        hint="Leave --seed out for a random one.",
        code="E2005",
    )


def port_empty() -> UsageError:
    return UsageError(
        "--port names no machine.",
        hint="Say sim:, sim:FILE, a serial port, socket://HOST:PORT, serial:ID or auto; or leave it out.",
        code="E2006",
    )


def home_folder_unknown(*, written: object) -> UsageError:
    return UsageError(
        f"The home folder in {written!r} is unknown.",
        hint=f"Write the whole path, or ./{written} for a file of that name.",
        code="E2007",
    )


def path_impossible(*, written: object, fault: object) -> UsageError:
    return UsageError(f"{written!r} is no path: {fault}.", hint="Correct the name.", code="E2007")


def template_is_a_file(*, shipped: object) -> UsageError:
    return UsageError(
        f"--from takes the name of a shipped profile, and {shipped} is a file.",
        hint='Copy the file, or write extends = "FILE" in a new one.',
        code="E2008",
    )


def start_without_paper_model() -> UsageError:
    return UsageError(
        "--start goes with --model paper alone: the other models begin as the actuator does, conditioned.",
        hint="Leave --start out, or say --model paper.",
        code="E2010",
    )


def calibration_with_paper_model() -> UsageError:
    return UsageError(
        "--calibration does not go with --model paper, which is fitted to one slow cycle of the actuator.",
        hint="Leave --calibration out.",
        code="E2010",
    )


def waveform_option_unused(*, option: object, waveform: object, reason: object) -> UsageError:
    return UsageError(
        f"{option} does not go with {waveform}: {reason}.", hint=f"Leave {option} out.", code="E2010"
    )


def waveform_file_missing() -> UsageError:
    return UsageError(
        "No CSV file was named.", hint="Say --from FILE.csv; it has the columns t_s and u_V.", code="E2010"
    )


def waveform_voltages_out_of_range(
    *, low_v: float, high_v: float, least_v: float, most_v: float
) -> UsageError:
    return UsageError(
        f"--low {low_v:g} and --high {high_v:g} do not ascend within the actuator's {least_v:g} to {most_v:g} V.",
        hint=f"Take {least_v:g} ≤ low < high ≤ {most_v:g}.",
        code="E2010",
    )


def waveform_too_slow(
    *, cycles: object, frequency_hz: float, longest_s: float, least_hz: float
) -> UsageError:
    return UsageError(
        f"{cycles} cycles of {frequency_hz:g} Hz do not end within {longest_s:g} s.",
        hint=f"With --cycles {cycles} take --frequency {least_hz:.2g} or more.",
        code="E2010",
    )


def waveform_too_fast(
    *, waveform: object, range_v: float, frequency_hz: float, slew_v_s: float, most_hz: float
) -> UsageError:
    return UsageError(
        f"A {waveform} of {range_v:g} V at {frequency_hz:g} Hz is steeper than the machine's {slew_v_s:g} V/s.",
        hint=f"Take --frequency {most_hz:g} or less, or a smaller range.",
        code="E2010",
    )


def figure_suffix_unknown(*, name: object, suffixes: object) -> UsageError:
    return UsageError(
        f"A figure cannot be written into {name!r}: its name ends in none of {suffixes}.",
        hint="Take .pdf or .svg for print and .png for the screen.",
        code="E2011",
    )


def data_suffix_unknown(*, data: object, data_suffixes: object) -> UsageError:
    return UsageError(
        f"Data cannot be written into {data!r}: its name ends in none of {data_suffixes}.",
        hint="Take .csv for spreadsheets and .h5 for long records.",
        code="E2012",
    )


def refit_unknown(*, text: object) -> UsageError:
    return UsageError(
        f"--refit {text!r} is neither 'zero' nor 'gain,zero'.",
        hint="The zero is always set again; the gain too where the record is of another day.",
        code="E2020",
    )


def previous_voltage_count(*, times: object, named: object) -> UsageError:
    return UsageError(
        f"--previous-voltage is given {times}, and {named} with --from and --validate.",
        hint="Give it once for all files, or once for each: those of --from first, then those of --validate.",
        code="E2021",
    )


def previous_voltage_not_finite() -> UsageError:
    return UsageError(
        "--previous-voltage is no finite number.",
        hint="Give volts; leave it out where the actuator had been cycled over the range of the record.",
        code="E2021",
    )


def delay_out_of_range(*, delay_s: float, longest_fixed_delay_s: float) -> UsageError:
    return UsageError(
        f"--delay {delay_s:g} s does not lie between 0 and {longest_fixed_delay_s:g} s.",
        hint="Give seconds; leave it out to have it found.",
        code="E2022",
    )


def other_fault_latched(*, code: object, latched: object, message: object, command: object) -> UsageError:
    return UsageError(
        f"Not fault {code} is latched but {latched}: {message}",
        hint=f"When its reason is gone: `{command}`.",
        code="E2030",
    )


def link_and_socket() -> UsageError:
    return UsageError("--link and --socket exclude each other.", hint="Leave one out.", code="E2040")


def speed_unknown(*, text: object, least_speed: float, most_speed: float, fastest: object) -> UsageError:
    return UsageError(
        f"--speed {text} is neither a number from {least_speed:g} to {most_speed:g} nor {fastest}.",
        hint=f"Say --speed 1 for a real machine's pace, --speed {fastest} for the fastest.",
        code="E2041",
    )


def socket_unreadable(*, text: object) -> UsageError:
    return UsageError(
        f"--socket {text} is no HOST:PORT.",
        hint="Say --socket 127.0.0.1:7000, or port 0 for any.",
        code="E2042",
    )


def injection_unreadable(*, problem: object) -> UsageError:
    return UsageError(f"{problem}", hint="Say --fault NAME or --fault NAME@sparks+2.", code="E2043")


def bench_of_another_seed(*, bench_file: object, serial: object, seed: object) -> UsageError:
    return UsageError(
        f"{bench_file} keeps {serial}, not the machine of --seed {seed}.",
        hint="Leave --seed out, or take another file for another machine.",
        code="E2044",
    )


def serving_time_impossible(*, seconds: object) -> UsageError:
    return UsageError(f"--for {seconds} is no length of time.", hint="Leave it out for no end.", code="E2045")


def wait_impossible(*, wait_s: object) -> UsageError:
    return UsageError(f"--wait {wait_s} is no length of time.", hint="Give seconds.", code="E2045")


def socket_open_to_others(*, text: object) -> UsageError:
    return UsageError(
        f"Other computers would reach {text}: whoever connects drives the machine.",
        hint="Serve on 127.0.0.1, or say --allow-remote and --secret-file FILE.",
        code="E2046",
    )


def remote_options_without_socket() -> UsageError:
    return UsageError(
        "--allow-remote and --secret-file are about a socket, and none is served.",
        hint="Say --socket HOST:PORT too, or leave them out.",
        code="E2046",
    )


def secret_file_unusable(*, problem: object, remedy: object) -> UsageError:
    return UsageError(f"{problem}", hint=f"{remedy}", code="E2047")


def arithmetic_unknown(*, real: object, reals: object) -> UsageError:
    return UsageError(f"--real {real} is no arithmetic.", hint=f"Say {reals}.", code="E2048")


def baud_fixed_by_image(*, asked: object, controller: object, only: object) -> UsageError:
    return UsageError(
        f"--baud {asked}: the line of the controller {controller} has {only} Bd.",
        hint=f"Leave it out; a host needs baud = {only} below [link] in its setup where its port is a UART.",
        code="E2049",
    )


def controller_unknown(*, name: object, controllers: object) -> UsageError:
    return UsageError(
        f"There is no controller {name}: it is one of {controllers}.",
        hint="Name one of them, or leave it out.",
        code="E2049",
    )


def emulated_bench_not_kept(*, stm32: object, path: object, firmware: object) -> UsageError:
    return UsageError(
        f"A bench under the controller {stm32} cannot be kept in {path}: an emulated chip has no file.",
        hint=f"Name no file for the bench, or say --controller {firmware}: the same core, and it is kept.",
        code="E2049",
    )


def resume_with_other_options(*, named: object) -> UsageError:
    return UsageError(
        f"--resume goes on with the job as it was; {named} would change it.",
        hint="Leave that out. --port, --wait, --out, --run-id, --homed and --restart-hole go with --resume.",
        code="E2050",
    )


def option_without_resume(*, lone: object) -> UsageError:
    return UsageError(f"{lone} goes with --resume only.", hint="Leave it out.", code="E2050")


def jump_period_too_short(*, period_s: float, least_s: float) -> UsageError:
    return UsageError(
        f"A jump every {period_s:g} s leaves no time to see the tool come to rest.",
        hint=f"Take --period-s {least_s:.1f} or more.",
        code="E2060",
    )


def site_unreadable(*, text: object) -> UsageError:
    return UsageError(
        f"--site {text} is no X,Y in µm.", hint="Say two numbers, e.g. --site 500,0.", code="E2061"
    )


def new_tool_without_reference() -> UsageError:
    return UsageError(
        "--new-tool goes with --reference: a tool that was changed has lost nothing yet.",
        hint="Say `edmctl measure-wear --reference --new-tool`.",
        code="E2062",
    )


def drift_duration_out_of_range(*, duration_s: float, setup: object) -> UsageError:
    return UsageError(
        f"{duration_s:g} s is no time for measuring drift.", hint=f"Give {setup}.", code="E2064"
    )


def too_few_drift_touches(
    *, duration_s: float, hold_s: float, interval_s: float, value: object, least: object
) -> UsageError:
    return UsageError(
        f"{duration_s:.0f} s with a hold of {hold_s:.0f} s and a touch every {interval_s:.0f} s make {value} touches; it takes {least}.",
        hint="Give it more time (--duration, drift.duration_s), or shorten drift.hold_s or drift.interval_s.",
        code="E2064",
    )


def answer_unusable(*, problem: object) -> UsageError:
    return UsageError(
        f"{problem}",
        hint='Lines as `estop-press = "done"`, `high-voltage = "yes"`, `battery-volts = 9.1`; docs/first-start.md lists all.',
        code="E2065",
    )


def yes_with_real_machine(*, selector: object) -> UsageError:
    return UsageError(
        f"--yes allows dangerous steps unseen, and {selector} is not a virtual machine in this process.",
        hint="Answer in a terminal, or name every step with --answers FILE.",
        code="E2067",
    )


def yes_beside_answers() -> UsageError:
    return UsageError(
        "--yes allows every step, and --answers names those that are allowed: one of the two.",
        hint="Leave --yes out.",
        code="E2067",
    )


def no_terminal() -> UsageError:
    return UsageError(
        "first-start asks, and nobody is at a terminal.",
        hint="Run it in a terminal, or give the answers with --answers FILE.",
        code="E2068",
    )


def terminal_closed() -> UsageError:
    return UsageError("The terminal was closed.", hint="Run first-start again.", code="E2068")


def figure_kind_unknown(*, name: object, meant: object, names: object) -> UsageError:
    return UsageError(
        f"There is no kind of figure {name!r}.", hint=f"{meant}There are {names}.", code="E2070"
    )


def figures_to_stdout() -> UsageError:
    return UsageError("Figures do not go to stdout.", hint="Name a file or a folder.", code="E2071")


def several_figures_one_file(*, suffixes_count: object, out: object) -> UsageError:
    return UsageError(
        f"{suffixes_count} figures do not go into the one file {out}.",
        hint="Name a folder with --out, or one figure with --kind.",
        code="E2071",
    )


def figure_format_unknown(*, form: object, formats: object) -> UsageError:
    return UsageError(f"There is no format {form!r}.", hint=f"There are {formats}.", code="E2072")


def report_is_html() -> UsageError:
    return UsageError(
        "A report is one HTML page, in no other format.",
        hint="Leave --format out; a browser prints the page as PDF.",
        code="E2072",
    )


def figure_ending_unknown(*, out: object, known: object) -> UsageError:
    return UsageError(
        f"There are no figures in the format of {out}.",
        hint=f"Names end in {known}; that of a folder that is not there yet has no ending.",
        code="E2072",
    )


def figure_name_ending(*, what: object, out: object, wanted: object, remedy: object) -> UsageError:
    return UsageError(
        f"{what} does not go into {out}: its name would have to end in {wanted}.",
        hint=f"{remedy}",
        code="E2072",
    )


def one_run_to_compare() -> UsageError:
    return UsageError("Only one run is named.", hint="Name at least two run files.", code="E2073")


def table_unknown(*, name: object, meant: object, known: object) -> UsageError:
    return UsageError(f"A run file has no table {name!r}.", hint=f"{meant}Tables: {known}.", code="E2080")


def study_table_not_csv(*, out: object) -> UsageError:
    return UsageError(
        f"{out} does not end in .csv.",
        hint="Write CSV, e.g. -o runs.csv; `edmctl study status DIR --json` has the same table as JSON.",
        code="E2081",
    )


def export_ending_unknown(*, out: object, ending: object, format: object) -> UsageError:
    return UsageError(
        f"Tables do not go into {out}: no format is called {ending}.",
        hint=f"Formats: {format}. A folder needs a name without an ending, or has to be there.",
        code="E2081",
    )


def export_format_unknown(*, asked: object, format: object) -> UsageError:
    return UsageError(f"There is no format {asked!r}.", hint=f"Formats: {format}.", code="E2081")


def several_tables_one_file(*, where: object, wanted_count: object) -> UsageError:
    return UsageError(
        f"{where} one table, not {wanted_count}.",
        hint="Name it with --table, or give a folder with -o.",
        code="E2082",
    )


def stdout_taken_by_json() -> UsageError:
    return UsageError(
        "With --json stdout is taken by its object.",
        hint="Give the table a file with -o; --format json writes it as JSON.",
        code="E2083",
    )


def export_format_and_ending(*, chosen: object, ending: object) -> UsageError:
    return UsageError(
        f"--format {chosen} does not go into a file called .{ending}.",
        hint=f"Call it .{chosen}, or leave --format out.",
        code="E2084",
    )


def parquet_on_terminal() -> UsageError:
    return UsageError("Parquet cannot be shown on a terminal.", hint="Give a file with -o.", code="E2085")


def board_unknown(*, board: object, boards: object) -> UsageError:
    return UsageError(f"There is no board {board}.", hint=f"Say {boards}.", code="E2090")


def compiler_unknown(*, compiler: object, compilers: object) -> UsageError:
    return UsageError(f"--compiler {compiler} is none that is known.", hint=f"Say {compilers}.", code="E2090")


def real_with_board() -> UsageError:
    return UsageError(
        "--real is for libraries; a board calculates in float.", hint="Leave it out.", code="E2090"
    )


def image_ending_unknown(*, place: object, suffixes: object) -> UsageError:
    return UsageError(
        f"--output {place} is no name of an image.", hint=f"End it with {suffixes}.", code="E2090"
    )


def output_without_board() -> UsageError:
    return UsageError(
        "--output is for the image of a board; libraries are kept in the user's cache folder.",
        hint="Say --board stm32f4, or name a cache folder in EDMCTL_FIRMWARE_CACHE.",
        code="E2090",
    )


def setting_without_board() -> UsageError:
    return UsageError(
        "--set is for the image of a board; virtual machines have a setup file.",
        hint="Say --board stm32f4.",
        code="E2090",
    )


def virtual_machine_has_no_board(*, selector: object) -> UsageError:
    return UsageError(
        f"{selector} is a virtual machine in this process, and no board.",
        hint="Name the port of a board; `edmctl ports` lists them.",
        code="E2091",
    )


def port_not_exact(*, port: object) -> UsageError:
    return UsageError(
        f"--port {port} would say hello to every controller, and stop what runs there.",
        hint="Name the port itself; `edmctl ports` lists them.",
        code="E2091",
    )


def flash_tool_unknown(*, named: object, tools: object) -> UsageError:
    return UsageError(f"There is no tool {named}.", hint=f"Say {tools}.", code="E2092")


def image_setting_wrong(*, problem: object, remedy: object) -> UsageError:
    return UsageError(f"{problem}", hint=f"{remedy}", code="E2094")


def folder_instead_of_study_file(*, path: object, quoted_path: object) -> UsageError:
    return UsageError(
        f"{path} is the folder of a study, and a study file is wanted.",
        hint=f"Go on with it: `edmctl study resume {quoted_path}`.",
        code="E2100",
    )


def folder_without_study(*, path: object, plan: object, reason: object) -> UsageError:
    return UsageError(
        f"{path} has no study: {plan}: {reason}.",
        hint="Name the folder that `edmctl study run FILE --out DIR` has made.",
        code="E2101",
    )


def study_without_machine() -> UsageError:
    return UsageError(
        "The study says nothing of a machine.",
        hint="Add [machine] to the study file (holes_per_tool, the grid of places), and plan it anew; without it every run has a virtual machine of its own.",
        code="E2103",
    )


def study_run_unknown(*, number: object, runs_count: object, command: object) -> UsageError:
    return UsageError(
        f"The study has no run {number}.",
        hint=f"Its runs are 1 to {runs_count}; `{command}` lists them.",
        code="E2104",
    )


def run_has_other_settings(*, number: object) -> UsageError:
    return UsageError(
        f"Run {number} of the study has other settings.",
        hint="It is of another study, or of a folder that was planned anew.",
        code="E2104",
    )


def run_number_unreadable(*, text: object) -> UsageError:
    return UsageError(f"{text!r} is no number of a run.", hint="Correct it.", code="E2104")


def response_unknown(*, response: object, found: object) -> UsageError:
    return UsageError(f"The study has no response {response}.", hint=f"There are {found}.", code="E2105")


def no_response_given(*, asked: object) -> UsageError:
    return UsageError("No response is given.", hint=f"Responses: {asked}.", code="E2105")


def response_value_wrong(*, name: object, value: object, asked: object) -> UsageError:
    return UsageError(
        f"{name} = {value!r} is no value of a response of the study.",
        hint=f"Give a possible number alone. Responses: {asked}.",
        code="E2105",
    )


def response_measured_by_run(*, number: object, name: object) -> UsageError:
    return UsageError(
        f"Run {number} has measured {name} itself.",
        hint="Tell manual responses; or judge the run, and make it again.",
        code="E2105",
    )


def response_not_manual(*, name: object, manual: object) -> UsageError:
    return UsageError(
        f"{name} is not a manual response of the study.",
        hint=f'Its responses with source = "manual": {manual}.',
        code="E2105",
    )


def response_value_missing(*, name: object, withdraws: object) -> UsageError:
    return UsageError(f"{name} has no value.", hint=f"Say e.g. {name}=0.31; {withdraws}.", code="E2105")


def response_not_a_number(*, name: object, text: object, remedy: object) -> UsageError:
    return UsageError(f"{name}={text}: that is no number.", hint=f"{remedy}", code="E2105")


def response_not_measured(*, name: object, value: object) -> UsageError:
    return UsageError(
        f"{name}={value}: that is no measured value.",
        hint="Leave out what is not measured: a run without it is not in its tables.",
        code="E2105",
    )


def response_out_of_bounds(*, name: object, value: float, unit: object, bounds: object) -> UsageError:
    return UsageError(
        f"{name} = {value:g}{unit} is not possible: the study says {bounds}{unit}.",
        hint="Look at the sign, the decimal point and the unit.",
        code="E2105",
    )


def response_unreadable(*, text: object, example: object) -> UsageError:
    return UsageError(f"{text} is no NAME=VALUE.", hint=f"Say e.g. {example}=0.31.", code="E2105")


def response_given_twice(*, name: object) -> UsageError:
    return UsageError(f"{name} is given twice.", hint="Give it once.", code="E2105")


def import_without_values(*, name: object, there: object) -> UsageError:
    return UsageError(
        f"{name} has no value of {there}.", hint="Fill it in, and save it as CSV again.", code="E2106"
    )


def import_unreadable(*, problem: object, remedy: object) -> UsageError:
    return UsageError(f"{problem}", hint=f"{remedy}", code="E2106")


def import_run_twice(*, name: object, line: object, number: object) -> UsageError:
    return UsageError(
        f"{name}, line {line}: run {number} is in the table twice.", hint="Keep one.", code="E2106"
    )


def judgement_without_reason() -> UsageError:
    return UsageError("The reason is empty.", hint='Say why, e.g. "chip under the tool".', code="E2107")


def judged_run_not_made(*, run: object, study: object) -> UsageError:
    return UsageError(
        f"Run {run} is not made yet.",
        hint=f"Make it with `{study}`, then judge it; one that shall not be made is rejected.",
        code="E2107",
    )


def attempt_not_the_last(*, number: object, attempts: object, text: object) -> UsageError:
    return UsageError(
        f"The last attempt at run {number} is {attempts}, and this is of {text}.",
        hint="Measure the last attempt, and write its number there; or leave the cell empty.",
        code="E2107",
    )


def measured_run_not_made(*, number: object, command: object) -> UsageError:
    return UsageError(
        f"Run {number} is not made yet: nothing of it can be measured.",
        hint=f"Check the number with `{command}`.",
        code="E2107",
    )


def workers_with_dask() -> UsageError:
    return UsageError(
        "--dask has the workers of its cluster.", hint="Leave --workers or --dask out.", code="E2108"
    )


def workers_on_one_machine() -> UsageError:
    return UsageError(
        "One machine makes one run at a time: --workers and --dask are for virtual ones.",
        hint="Leave them out.",
        code="E2108",
    )


def machine_options_without_machine() -> UsageError:
    return UsageError(
        "--new-tool and --homed are about a machine that lasts, and none is named.",
        hint="Say --port, or leave them out.",
        code="E2108",
    )


def new_tool_in_interrupted_hole(*, number: object, run: object) -> UsageError:
    return UsageError(
        f"Run {number} was interrupted; another tool cannot go on with its hole.",
        hint=f"Leave --new-tool out; or give the hole up: `{run}`, and make it anew with --new-tool.",
        code="E2108",
    )


def study_of_another_machine(*, port: object, making_command: object) -> UsageError:
    return UsageError(
        f"The study is made on the machine at {port}.", hint=f"Go on there: `{making_command}`.", code="E2108"
    )


def study_has_virtual_runs() -> UsageError:
    return UsageError(
        "The study has runs on virtual machines already.",
        hint="Make another study on the machine, in another folder; or leave --port out.",
        code="E2108",
    )


def study_has_folder(*, value: object) -> UsageError:
    return UsageError(f"{value!r} has its folder already.", hint="Load the study file.", code="E2109")


def study_without_folder(*, value: object) -> UsageError:
    return UsageError(f"{value!r} has no folder yet.", hint='Make it with .start("out").', code="E2109")


def setting_out_of_range(*, key: object, value: object, allowed: object) -> UsageError:
    return UsageError(
        f"{key} = {value!r} is not {allowed}.",
        hint="The study varies it within that; another study has other bounds.",
        code="E2110",
    )


def settings_incomplete(*, keys: object) -> UsageError:
    return UsageError(f"Settings have a value of each of {keys}.", hint="Leave others out.", code="E2110")


def series_table_not_csv(*, table: object) -> UsageError:
    return UsageError(f"--table {table} is no .csv file.", hint="Call it FILE.csv.", code="E2113")


def record_file_unreadable(*, path: object, why: object, remedy: object) -> RecordError:
    return RecordError(f"Cannot read the record {path}: {why}.", hint=f"{remedy}", code="E3601")


def table_malformed(*, name: object) -> RecordError:
    return RecordError(
        f"{name} is neither UTF-8 text nor HDF5.", hint="Save or export it as CSV in UTF-8.", code="E3602"
    )


def table_unreadable(*, path: object, reason: object) -> RecordError:
    return RecordError(
        f"Cannot read {path}: {reason}.", hint="Check the path and its permissions.", code="E3602"
    )


def table_without_columns(*, name: object, problem: object) -> RecordError:
    return RecordError(
        f"{name} {problem}.",
        hint="Name the columns in a line, and write a line per row below it.",
        code="E3602",
    )


def record_without_rows(*, path: object, rows: object) -> RecordError:
    return RecordError(f"{path} holds {rows} of numbers.", hint="Give a row per sample.", code="E3605")


def hdf5_record_wrong(*, problem: object, remedy: object) -> RecordError:
    return RecordError(f"{problem}", hint=f"{remedy}", code="E3606")


def run_without_sensor(*, path: object) -> RecordError:
    return RecordError(
        f"{path} is the run of a machine without a displacement sensor: nothing tells where the tool was.",
        hint="Give a run that was made with a sensor.",
        code="E3606",
    )


def columns_differ_in_length(*, path: object, each: object) -> RecordError:
    return RecordError(
        f"{path}: its columns differ in length: {each}.",
        hint="Every sample has a time, a voltage and a displacement.",
        code="E3606",
    )


def not_hdf5(*, path: object) -> RecordError:
    return RecordError(
        f"{path} is not HDF5.", hint="Give an HDF5 file, or a CSV file under the name .csv.", code="E3606"
    )


def hdf5_unreadable(*, path: object, error: object) -> RecordError:
    return RecordError(
        f"{path} cannot be read as HDF5: {error}.",
        hint="It may be cut off or damaged: copy or record it again.",
        code="E3606",
    )


def record_too_short(*, record: object, count: object, least: object) -> RecordError:
    return RecordError(
        f"{record}: {count} samples are too few.",
        hint=f"Record {least} samples or more: full swings and a hold, at 100 Hz or faster.",
        code="E3611",
    )


def record_not_finite(
    *, record: object, wrong: object, count: object, column: object, first: object
) -> RecordError:
    return RecordError(
        f"{record}: {wrong} of {count} values of {column} are not finite, the first at sample {first}.",
        hint="Leave out the samples where the instrument gave no number, or repair the recording.",
        code="E3612",
    )


def record_values_too_large(*, file: object, values: object) -> RecordError:
    return RecordError(
        f"{file}: {values}.",
        hint="Leave out the samples where the instrument gave no number, or repair the recording.",
        code="E3612",
    )


def waveform_not_finite(*, row: object) -> RecordError:
    return RecordError(f"{row} is not finite.", hint="Correct or delete it.", code="E3612")


def record_time_stands_still(
    *, record: object, sample: object, after_s: float, before_s: float, steps: object
) -> RecordError:
    return RecordError(
        f"{record}: time stands still at sample {sample}, {after_s:.9g} s after {before_s:.9g} s (such steps in all: {steps}).",
        hint="Write t_s with more digits, or leave out the repeated samples.",
        code="E3613",
    )


def record_time_goes_back(
    *, record: object, sample: object, after_s: float, before_s: float, steps: object
) -> RecordError:
    return RecordError(
        f"{record}: time goes back at sample {sample}, {after_s:.9g} s after {before_s:.9g} s (such steps in all: {steps}).",
        hint="Sort the samples by time; give records made one after the other as files of their own.",
        code="E3613",
    )


def waveform_time_not_ascending(*, row: object) -> RecordError:
    return RecordError(f"{row} is not later than the one before.", hint="Sort by t_s.", code="E3613")


def record_voltage_constant(*, record: object, what: object) -> RecordError:
    return RecordError(
        f"{record}: the voltage is {what}.",
        hint="Drive the actuator over its range; check which column is u_V.",
        code="E3614",
    )


def record_displacement_constant(*, record: object, y_um: float, span_v: float) -> RecordError:
    return RecordError(
        f"{record}: the displacement is always {y_um:g} µm, while the voltage spans {span_v:g} V.",
        hint="Check the sensor and its cable, and which column is y_um.",
        code="E3615",
    )


def record_displacement_unrelated(*, record: object, correlation: float) -> RecordError:
    return RecordError(
        f"{record}: the displacement does not follow the voltage (correlation {correlation:.2f}).",
        hint="Check that u_V and y_um are of one measurement and on one clock, and that the sensor sees the tool.",
        code="E3615",
    )


def record_clipped(
    *, record: object, end: object, limit_um: float, first: object, percent: float
) -> RecordError:
    return RecordError(
        f"{record}: the displacement stands at its {end} end, {limit_um:g} µm, from sample {first}, while the voltage goes on by {percent:.0f} % of its span.",
        hint="The sensor or the amplifier is at its limit: move the sensor or drive less, and record again.",
        code="E3616",
    )


def record_reversed(*, record: object, correlation: float) -> RecordError:
    return RecordError(
        f"{record}: the displacement falls while the voltage rises (correlation {correlation:.2f}).",
        hint="Negate y_um: it grows when the tool moves towards the work.",
        code="E3617",
    )


def record_period_too_long(*, record: object, period_s: float) -> RecordError:
    return RecordError(
        f"{record}: its sample period is {period_s:g} s.",
        hint="If t_s is in µs, multiply it by 1e-6; in ms, by 0.001.",
        code="E3618",
    )


def record_voltage_too_large(*, record: object, span_v: float) -> RecordError:
    return RecordError(
        f"{record}: the voltage spans {span_v:g} V.",
        hint="u_V looks like mV: multiply it by 0.001.",
        code="E3618",
    )


def record_in_other_units(
    *,
    record: object,
    range_um: float,
    span_v: float,
    slope: float,
    column: object,
    unit: object,
    factor: object,
) -> RecordError:
    return RecordError(
        f"{record}: {range_um:.3g} µm over {span_v:.3g} V, {slope:.3g} µm/V, is no displacement of an actuator.",
        hint=f"{column} looks like {unit}: multiply it by {factor}.",
        code="E3618",
    )


def no_model_fits(*, error: object) -> RecordError:
    return RecordError(
        f"No model can be fitted: {error}.",
        hint="Record full swings and holds of a minute over the whole range, at 100 Hz or faster.",
        code="E3619",
    )


def lever_lengths_differ(*, stack_samples: object, tool_samples: object) -> RecordError:
    return RecordError(
        f"{stack_samples} samples of the stacks' displacement, but {tool_samples} of the tool's",
        hint="Record both at the same instants.",
        code="E3620",
    )


def lever_samples_too_few(*, stack_count: object, least_samples: object) -> RecordError:
    return RecordError(
        f"{stack_count} samples are too few for a lever factor, at least {least_samples} are needed",
        hint="Record a slow swing over the whole range.",
        code="E3621",
    )


def lever_sample_not_finite(*, wrong: object) -> RecordError:
    return RecordError(
        f"sample {wrong} of the displacements is not a finite number",
        hint="Remove the samples that the sensor could not measure.",
        code="E3622",
    )


def lever_values_too_large(*, file: object, values: object) -> RecordError:
    return RecordError(
        f"{file}: {values}.",
        hint="Leave out the samples where the instrument gave no number, or repair the recording.",
        code="E3622",
    )


def lever_at_rest(*, stack: float) -> RecordError:
    return RecordError(
        f"the stacks' displacement stays at {stack:g} µm",
        hint="Drive the actuator over its range while both sensors are read.",
        code="E3623",
    )


def lever_reversed(*, factor: float) -> RecordError:
    return RecordError(
        f"the tool moves back while the stacks extend (factor {factor:.3g})",
        hint="Reverse the sign of one of the two sensors.",
        code="E3624",
    )


def lever_factor_impossible(*, factor: float) -> RecordError:
    return RecordError(
        f"a lever factor of {factor:.3g} is not that of a flexure (paper: 18)",
        hint="Give both displacements in µm, and the stacks' and the tool's in the right columns.",
        code="E3625",
    )


def record_ahead_of_voltage(*, record: object, percent: float) -> RecordError:
    return RecordError(
        f"{record}: the displacement runs ahead of the voltage (loops open the wrong way by {percent:.0f} %).",
        hint="Check that the columns u_V and y_um are not exchanged, and that both are on one clock.",
        code="E3626",
    )


def waveform_beyond_actuator(*, row: object, low_v: float, high_v: float) -> RecordError:
    return RecordError(f"{row} is outside {low_v:g} to {high_v:g} V.", hint="u_V is in volts.", code="E3630")


def waveform_too_long(*, path: object, length_s: float, longest_s: float) -> RecordError:
    return RecordError(
        f"{path} lasts {length_s:.0f} s; {longest_s:g} s is the longest.",
        hint="Cut it into several; t_s is in seconds.",
        code="E3631",
    )


def image_unreadable(*, path: object, reason: object) -> RecordError:
    return RecordError(
        f"Cannot read {path}: {reason}.",
        hint="Name an image that `edmctl firmware build --board stm32f4` has made.",
        code="E3680",
    )


def not_an_image(*, path: object, reason: object) -> RecordError:
    return RecordError(
        f"{path} is no image of this firmware: {reason}.",
        hint="Name an image that `edmctl firmware build --board stm32f4` has made.",
        code="E3681",
    )


def image_damaged(*, path: object, reason: object) -> RecordError:
    return RecordError(
        f"{path} is damaged: {reason}.",
        hint="Build it anew with `edmctl firmware build --board stm32f4`, or copy it again.",
        code="E3682",
    )


def session_not_open() -> LinkLost:
    return LinkLost("The session is not open.", hint="Open it first.", code="E4000")


def simulated_line_closed() -> LinkLost:
    return LinkLost(
        "The line to the virtual machine is closed.", hint="Open the machine again.", code="E4000"
    )


def port_absent(*, url: object, known_ports: object) -> LinkLost:
    return LinkLost(
        f"There is no port {url}.", hint=f"{known_ports} Check the cable and the name.", code="E4001"
    )


def nothing_at_address(*, url: object, reason: object) -> LinkLost:
    return LinkLost(
        f"Nothing answers at {url}: {reason}.",
        hint="Check the address, and whether it is served.",
        code="E4001",
    )


def port_cannot_be_opened(*, url: object, reason: object, known_ports: object) -> LinkLost:
    return LinkLost(f"Cannot open {url}: {reason}.", hint=f"{known_ports} Check the cable.", code="E4001")


def no_controller_answers(*, answers: object, remedy: object) -> LinkLost:
    return LinkLost(f"No controller answers. {answers}", hint=f"{remedy}", code="E4001")


def controller_not_found(*, wanted: object, answers: object, remedy: object) -> LinkLost:
    return LinkLost(f"No controller {wanted} answers. {answers}", hint=f"{remedy}", code="E4001")


def port_option_unusable(*, filename: object, url: object, reason: object) -> LinkLost:
    return LinkLost(
        f"Cannot open {filename}, which {url} names: {reason}.",
        hint="Correct the path, or leave that option out.",
        code="E4002",
    )


def address_invalid(*, url: object, remedy: object) -> LinkLost:
    return LinkLost(f"{url} is no valid address.", hint=f"{remedy}", code="E4002")


def not_a_serial_port(*, url: object, known_ports: object) -> LinkLost:
    return LinkLost(f"{url} is no serial port.", hint=f"Name one. {known_ports}", code="E4002")


def port_is_another_thing(*, url: object, kind: object, known_ports: object) -> LinkLost:
    return LinkLost(f"{url} is {kind}.", hint=f"Name a serial port. {known_ports}", code="E4002")


def serial_number_missing() -> LinkLost:
    return LinkLost(
        "serial: names no serial number.",
        hint="Say serial:ID; `edmctl ports --probe` lists them.",
        code="E4002",
    )


def line_broken(*, problem: object, remedy: object) -> LinkLost:
    return LinkLost(f"{problem}", hint=f"{remedy}", code="E4003")


def simulated_line_broken() -> LinkLost:
    return LinkLost("The line to sim: broke: it was unplugged.", hint="Check the cable.", code="E4003")


def port_permission_denied(*, url: object, remedy: object) -> LinkLost:
    return LinkLost(f"No permission to open {url}.", hint=f"{remedy}", code="E4004")


def controller_restarted(*, name: object, cause: object, boot_count: object, hint: object) -> LinkLost:
    return LinkLost(
        f"The controller at {name} restarted: {cause} (boot {boot_count}).",
        hint=f"{hint} Pulses are off and the tool is retracted.",
        code="E4005",
    )


def port_held(*, name: object, owner: object) -> LinkLost:
    return LinkLost(
        f"{name} is held by {owner}.",
        hint="End the other program, or wait for it with --wait SECONDS.",
        code="E4006",
    )


def port_in_use(*, device: object, owner: object) -> LinkLost:
    return LinkLost(
        f"{device} is held by {owner}: a job may run on the board behind it.",
        hint="End the other program, or name the port of the board that is meant with --port.",
        code="E4006",
    )


def several_controllers(*, count: object, how: object, named: object) -> LinkLost:
    return LinkLost(f"{count} controllers answer{how}.", hint=f"Say which: {named}.", code="E4007")


def simulated_controller_fails(*, name: object, message: object) -> LinkLost:
    return LinkLost(
        f"The simulated controller at {name} {message}.",
        hint="See whether `edmctl simulate serve` still runs, and start it again.",
        code="E4008",
    )


def clock_refuses_to_advance(*, name: object) -> LinkLost:
    return LinkLost(
        f"The controller at {name} says that its clock is driven, but refuses ADVANCE.",
        hint="Serve it again with the `edmctl` of this version.",
        code="E4008",
    )


def no_reply(*, name: object, command: object, waited_s: float) -> LinkLost:
    return LinkLost(
        f"The controller at {name} did not answer {command} within {waited_s:.0f} ms.",
        hint="Check that the controller is on and that the cable and the port are the right ones.",
        code="E4010",
    )


def no_answer_to_hello(*, name: object, waited_s: float) -> LinkLost:
    return LinkLost(
        f"No controller answered at {name} within {waited_s:.1f} s.",
        hint="Check that the controller is on and that this is its port (`edmctl ports` lists them).",
        code="E4011",
    )


def not_a_controller(*, name: object, bytes_received: object) -> LinkLost:
    return LinkLost(
        f"What is at {name} is no controller of this kind: {bytes_received} bytes came, and no answer to HELLO.",
        hint="Name the controller's port (`edmctl ports` lists them), and check link.baud in the setup.",
        code="E4011",
    )


def controller_silent(*, name: object, silence_s: float) -> LinkLost:
    return LinkLost(
        f"The controller at {name} fell silent for {silence_s:.0f} ms.",
        hint="Check cable and supply; the controller switches the pulses off by itself when it hears nothing.",
        code="E4012",
    )


def answer_for_another_host(*, name: object) -> LinkLost:
    return LinkLost(
        f"The answer to HELLO from {name} was meant for another host.",
        hint="Close the other program.",
        code="E4013",
    )


def session_taken_over(*, name: object) -> LinkLost:
    return LinkLost(
        f"Another host has opened a session with the controller at {name}.",
        hint="Close the other program; the controller has made the machine safe by itself.",
        code="E4013",
    )


def no_telemetry() -> LinkLost:
    return LinkLost("The controller sent no telemetry.", hint="Check the line, and try again.", code="E4020")


def no_telemetry_of_jump(*, number: object) -> LinkLost:
    return LinkLost(
        f"The telemetry shows nothing of jump {number}.",
        hint="Look at the line with `edmctl doctor`, and try again.",
        code="E4020",
    )


def link_cannot_be_made(*, link: object, reason: object) -> LinkLost:
    return LinkLost(
        f"Cannot make the link {link}: {reason}.", hint="Take another path for --link.", code="E4021"
    )


def host_unknown(*, host: object) -> LinkLost:
    return LinkLost(f"Cannot serve on {host}: no such host.", hint="Take another host.", code="E4021")


def socket_cannot_be_served(*, host: object, port: object, reason: object) -> LinkLost:
    return LinkLost(
        f"Cannot serve on {host}:{port}: {reason}.", hint="Take another host or port.", code="E4021"
    )


def secret_needed(*, name: object) -> LinkLost:
    return LinkLost(
        f"{name} asks for a secret.",
        hint="Name the file that holds it: EDMCTL_SECRET_FILE, or link.secret_file in the setup.",
        code="E4023",
    )


def secret_refused(*, name: object, reason: object) -> LinkLost:
    return LinkLost(f"{name} {reason}.", hint="Both ends need the same secret file.", code="E4023")


def protocol_differs(
    *,
    name: object,
    major: object,
    minor: object,
    its_hash: int,
    proto_major: object,
    proto_minor: object,
    own_hash: int,
    verdict: object,
    ask: object,
    remedy: object,
) -> ProtocolMismatch:
    return ProtocolMismatch(
        f"The controller at {name} speaks EDM Link {major}.{minor} (schema {its_hash:08X}), this program {proto_major}.{proto_minor} (schema {own_hash:08X}): {verdict}.{ask}",
        hint=f"{remedy}",
        code="E5000",
    )


def not_edm_link(*, name: object) -> ProtocolMismatch:
    return ProtocolMismatch(
        f"What answers at {name} does not speak EDM Link.",
        hint="Check that this is the controller's port.",
        code="E5000",
    )


def reply_unreadable(*, name: object, error: object, update: object) -> ProtocolMismatch:
    return ProtocolMismatch(
        f"The controller's reply to {name} cannot be read: {error}.", hint=f"{update}", code="E5000"
    )


def state_not_reached(*, wanted: object, when: object) -> MachineFault:
    return MachineFault(
        f"The controller did not report {wanted} {when}.",
        hint="The tool was told to retract. Look at the controller's log before the next run.",
        code="E6001",
    )


def tool_not_back(*, patience_s: float) -> MachineFault:
    return MachineFault(
        f"The controller did not bring the tool back within {patience_s:.0f} s.",
        hint="Switch the amplifier off, and look at the controller before the next run.",
        code="E6002",
    )


def touches_scatter(*, kind: object, sd_um: float, most_um: float) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{kind}: the touches scatter by {sd_um:.2f} µm, measure.max_sd_um is {most_um:.2f} µm.",
        hint="Clean tool and work, lower measure.speed_um_s, or allow more with measure.max_sd_um.",
        code="E7020",
    )


def touches_identical(*, kind: object, z_um: float) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{kind}: every touch says {z_um:.3f} µm to the last digit, which no sensor does.",
        hint="Look at sensor and line with `edmctl doctor`; the controller's touches are not to be believed.",
        code="E7021",
    )


def spots_disagree(
    *, kind: object, found_count: object, surface: object, message: object
) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{kind}: no two of {found_count} spots of the {surface} agree on the longest reading: {message} µm.",
        hint=f"Clean tool and work, and look whether the {surface} is flat for a tool's width around there.",
        code="E7022",
    )


def tool_grew(*, z_um: float, um: float, u_um: float) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"Z3 = {z_um:.2f} µm: the tool is {um:.2f} µm longer than before the cut (standard uncertainty {u_um:.2f} µm), which it cannot be.",
        hint="Clean the face of the tool and the reference pad, and look whether the tool has slipped in its chuck.",
        code="E7023",
    )


def reference_not_steady(*, drift_um: object, most_um: float) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"Z3 moved by {drift_um} µm while the hole was measured; at most {most_um:g} µm are allowed.",
        hint="Let machine and dielectric warm up, look for chips on the pad, and measure again.",
        code="E7040",
    )


def drift_not_conclusive(*, what: object) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"Rests and touches do not go together: {what}. Nothing is kept.",
        hint="Let machine and dielectric warm up, clean tool and pad, and measure again.",
        code="E7041",
    )


def items_skipped(*, count: object, items: object, titles: object) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{count} of {items} items were skipped: {titles}.",
        hint="Do the checklist again, with all of them, before the machine is used.",
        code="E7050",
    )


def simulated_runs_failed(
    *, failed_count: object, runs: object, seed: object, error: object, request: object
) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{failed_count} of {runs} failed; the first, with seed {seed}: {error}",
        hint=f"Repeat it with `{request}`.",
        code="E7900",
    )


def study_runs_failed(*, runs: object, number: object, error: object, command: object) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"{runs} failed; the first, run {number}: {error}",
        hint=f"Judge each: `{command} RUN accept|reject|repeat REASON`.",
        code="E7910",
    )


def recommendation_breaks_limits(*, broken: object, command: object) -> ObjectiveNotReached:
    return ObjectiveNotReached(
        f"The recommended settings do not keep {broken}: the mean of the confirmation runs does not.",
        hint=f"The report says so too. Make more runs (`{command}`, then `resume`), or ask a new study for a stricter limit.",
        code="E7911",
    )


def controller_refuses_settings(*, error: object) -> PreconditionError:
    return PreconditionError(
        f"The controller cannot be set so: {error}.",
        hint="Change the value in the setup or in the profile.",
        code="E8011",
    )


def bench_absent(*, file: object) -> PreconditionError:
    return PreconditionError(
        f"There is no bench {file}, and a new one holds no fault.",
        hint="Name the machine that holds the fault with --port or EDMCTL_PORT.",
        code="E8013",
    )


def sensor_reading_at_rest(
    *, here_um: float, drift_um: float, safe_z_um: float, stages_by_hand: object
) -> PreconditionError:
    return PreconditionError(
        f"The sensor reads {here_um:.1f} µm at 0 V and may have drifted by {drift_um:.1f} µm since the controller came up; the stages may move within {safe_z_um:.1f} µm of home only.",
        hint=f"Check that the tool is retracted and free, set the displacement sensor to zero, and restart the controller. {stages_by_hand}",
        code="E8020",
    )


def tool_not_home(*, problem: object, remedy: object) -> PreconditionError:
    return PreconditionError(f"{problem}", hint=f"{remedy}", code="E8020")


def rest_moved(*, zero_um: float, time_s: float, most_um: float) -> PreconditionError:
    return PreconditionError(
        f"The rest at 0 V has moved by {zero_um:.1f} µm in {time_s:.0f} s; creep and drift account for {most_um:.1f} µm.",
        hint="Check the displacement sensor, the actuator's supply, and whether something holds the tool.",
        code="E8020",
    )


def contact_closed(*, here_um: float, where: object, remedy: object) -> PreconditionError:
    return PreconditionError(
        f"The contact sensor reads closed at {here_um:.1f} µm{where}.", hint=f"{remedy}", code="E8021"
    )


def no_sensor_fitted() -> PreconditionError:
    return PreconditionError(
        "No displacement sensor is fitted (setup: sensor.fitted = false).",
        hint="Say --allow-model to go by the calibrated actuator alone, with the uncertainty that this brings.",
        code="E8030",
    )


def no_calibration(*, serial: object, calibrate: object) -> PreconditionError:
    return PreconditionError(
        f"No displacement sensor is fitted, and no calibration of {serial} was found.",
        hint=f"Run `{calibrate}` once with a borrowed sensor, and name its file with --calibration.",
        code="E8031",
    )


def calibration_range_too_small(
    *, path: object, low_v: float, high_v: float, top_v: float
) -> PreconditionError:
    return PreconditionError(
        f"No sensor is fitted, and {path} covers {low_v:.1f} V to {high_v:.1f} V; limits.stroke_v_max is {top_v:.1f} V, from 0 V on.",
        hint="Calibrate from 0 V over the whole stroke, or lower limits.stroke_v_max to what it covers.",
        code="E8032",
    )


def sensor_contradicts_voltage(*, slope_um_per_v: object, u_v: float) -> PreconditionError:
    return PreconditionError(
        f"The displacement sensor shows {slope_um_per_v} µm per volt while the actuator swings over {u_v:.0f} V.",
        hint="Check the sensor, its cable and its sign; without one say sensor.fitted = false in the setup.",
        code="E8033",
    )


def calibrating_without_sensor() -> PreconditionError:
    return PreconditionError(
        "No displacement sensor is fitted (setup: sensor.fitted = false), and a calibration is made with one.",
        hint="Borrow one and calibrate with sensor.fitted = true, or give measured data with --from FILE.",
        code="E8034",
    )


def drift_without_sensor() -> PreconditionError:
    return PreconditionError(
        "No displacement sensor is fitted (setup: sensor.fitted = false): there are no rests that could drift.",
        hint="Wear without a sensor rests on the actuator's model; `edmctl calibrate` makes that.",
        code="E8034",
    )


def conditioning_off_without_sensor() -> PreconditionError:
    return PreconditionError(
        "No sensor is fitted, and actuator.conditioning_cycles is 0: nobody knows what the actuator remembers.",
        hint="Let it swing twice before the job: actuator.conditioning_cycles = 2 in the setup.",
        code="E8035",
    )


def conditioning_insufficient(*, error: object) -> PreconditionError:
    return PreconditionError(
        f"The conditioning swings tell too little of the actuator: {error}.",
        hint="Lower actuator.conditioning_slew_v_s, or raise actuator.conditioning_cycles or controller.telemetry_hz in the setup.",
        code="E8036",
    )


def paper_table_out_of_range(*, error: object) -> PreconditionError:
    return PreconditionError(
        f"Table 1 of the paper cannot drive this actuator: {error}.",
        hint="Take the actuator of another --seed.",
        code="E8037",
    )


def calibration_contradicted(*, evidence: object) -> PreconditionError:
    return PreconditionError(
        f"The calibration is not this actuator's: {evidence}.",
        hint="Run `edmctl calibrate` here, or leave the calibration out.",
        code="E8038",
    )


def doctor_checks_failed(*, failed_count: object, done_count: object, failed: object) -> PreconditionError:
    return PreconditionError(
        f"{failed_count} of {done_count} checks failed: {failed}.",
        hint="The fix stands beside each of them.",
        code="E8040",
    )


def reference_missing(
    *, tool: object, machine: object, ledger: object, others: object, touch: object
) -> PreconditionError:
    return PreconditionError(
        f"There is no reference of {tool} on {machine} in {ledger}{others}.",
        hint=f"Run {touch} before the job, or name the folder of its run files with --out.",
        code="E8041",
    )


def reference_on_fresh_machine() -> PreconditionError:
    return PreconditionError(
        "There is no reference: a fresh virtual machine has touched nothing before.",
        hint="Say --port sim:FILE for one that stays, and `edmctl measure-wear --reference` before the job.",
        code="E8041",
    )


def reference_on_new_bench(*, bench_file: object, others: object, touch: object) -> PreconditionError:
    return PreconditionError(
        f"There is no reference: {bench_file} does not exist, and a new bench has touched nothing before.{others}",
        hint=f"Name the file of the bench that the job ran on (--port sim:FILE), or run {touch} before a job.",
        code="E8041",
    )


def place_unreachable(*, problem: object, remedy: object) -> PreconditionError:
    return PreconditionError(f"{problem}.", hint=f"{remedy}.", code="E8042")


def place_near_pad(*, name: object, x_um: object, away_um: object, clear_um: float) -> PreconditionError:
    return PreconditionError(
        f"{name} at {x_um} is {away_um} from the reference pad; sparks there would spoil what Z1 and Z3 are touched on.",
        hint=f"Keep {clear_um:.0f} µm away, or touch it with --contact.",
        code="E8042",
    )


def place_taken(*, name: object, x_um: object, hole: object) -> PreconditionError:
    return PreconditionError(
        f"{name} at {x_um} would run into {hole}.",
        hint="Give it another place, or keep the run files of new work in another folder with --out; `edmctl machine --resume` finishes an interrupted hole or channel.",
        code="E8042",
    )


def tool_worn_out(*, lost: object, wear_um: object, limit_um: object, remedy: object) -> PreconditionError:
    return PreconditionError(
        f"{lost} and would lose {wear_um} more; tool.max_wear_um is {limit_um}.",
        hint=f"{remedy}",
        code="E8043",
    )


def stroke_used_up(
    *, label: object, pad_um: object, stroke_um: object, available_um: object, remedy: object
) -> PreconditionError:
    return PreconditionError(
        f"{label} touches the pad at {pad_um} by now; a stroke of {stroke_um} is needed then, and the actuator has {available_um}.",
        hint=f"{remedy}",
        code="E8044",
    )


def hole_unknown(*, asked: object, names: object) -> PreconditionError:
    return PreconditionError(
        f"The ledger knows no hole {asked!r}; it knows: {names}.",
        hint="Name one of them, its run id, or say --site X,Y within its rim.",
        code="E8045",
    )


def hole_without_bottom(*, hole: object) -> PreconditionError:
    return PreconditionError(
        f"{hole} goes through the sheet and has no bottom to touch.",
        hint="Leave --site out to measure the wear alone.",
        code="E8045",
    )


def hole_depth_unknown(*, hole: object, run_file: object, remedy: object) -> PreconditionError:
    return PreconditionError(
        f"Nobody knows how deep {hole} is: {run_file} ended before it was measured.",
        hint=f"{remedy}",
        code="E8045",
    )


def tool_wider_than_hole(*, diameter_um: object, hole: object, radius_um: object) -> PreconditionError:
    return PreconditionError(
        f"A tool of {diameter_um} does not go into {hole}, which is {radius_um} wide.",
        hint="Name a hole that this tool made, or leave --site out.",
        code="E8046",
    )


def jump_too_high(*, start_um: float, height_um: float) -> PreconditionError:
    return PreconditionError(
        f"The tool hangs at {start_um:.1f} µm and cannot jump up by {height_um:g} µm.",
        hint="Take a lower jump with --height-um, or a deeper target.",
        code="E8047",
    )


def tool_length_unknown(*, label: object, stem: object, remedy: object) -> PreconditionError:
    return PreconditionError(
        f"The length of the tool {label} is unknown: the run {stem} was killed while it machined.",
        hint=f"{remedy}",
        code="E8048",
    )


def items_failed(*, count: object, items: object, titles: object) -> PreconditionError:
    return PreconditionError(
        f"{count} of {items} items failed: {titles}.",
        hint="The likely mistakes stand beside each; the machine is not to be used before all pass.",
        code="E8049",
    )


def run_without_journal(*, run_id: object, which: object, recover: object) -> PreconditionError:
    return PreconditionError(
        f"{run_id} has no journal, so nobody knows how far it came.",
        hint=f"A fresh virtual machine (sim:) is gone with its command and keeps none; jobs on sim:FILE, on a served bench and on hardware do. {which}{recover}",
        code="E8050",
    )


def run_unknown(*, run_id: object, where: object, which: object) -> PreconditionError:
    return PreconditionError(
        f"There is no run {run_id} in {where}.", hint=f"{which} --out names another folder.", code="E8050"
    )


def run_went_on(*, run_id: object) -> PreconditionError:
    return PreconditionError(
        f"{run_id} went on while this command waited for the machine.",
        hint="Look at its result; if it was interrupted again, say the same command again.",
        code="E8051",
    )


def run_finished(*, run_id: object, finished: object) -> PreconditionError:
    return PreconditionError(
        f"{run_id} is finished; its result is in {finished}.",
        hint="There is nothing to take up again.",
        code="E8051",
    )


def journal_of_another_version(*, path: object, error: object) -> PreconditionError:
    return PreconditionError(
        f"The journal {path} does not fit this version: {error}.",
        hint="Take the run up again with the version of edmctl that wrote it.",
        code="E8052",
    )


def journal_of_later_version(*, path: object, later: object, version: object) -> PreconditionError:
    return PreconditionError(
        f"The journal {path} was written by a later edmctl: version {later}, this one knows {version}.",
        hint="Take the run up again with that version of edmctl.",
        code="E8052",
    )


def journal_damaged(*, path: object, error: object) -> PreconditionError:
    return PreconditionError(
        f"The journal {path} is damaged: {error}.",
        hint="Without it nobody knows how deep the hole is. Machine it at another place or on new work.",
        code="E8052",
    )


def job_differs(
    *, what: object, which: object, how: object, run_id: object, remedy: object
) -> PreconditionError:
    return PreconditionError(
        f"The {what} {which} {how}; {run_id} was another job.", hint=f"{remedy}", code="E8053"
    )


def machine_differs(
    *, serial: object, run_id: object, serial_then: object, port: object
) -> PreconditionError:
    return PreconditionError(
        f"This is {serial}; {run_id} ran on {serial_then}, where its work is.",
        hint=f"Name that machine with --port (it was {port}).",
        code="E8055",
    )


def tool_was_replaced(*, label: object, replaced_by: object, reference_command: object) -> PreconditionError:
    return PreconditionError(
        f"{label} was replaced by {replaced_by} after its reference; a tool that is clamped again has another length.",
        hint=f"Run `{reference_command}` before its next job, or start that job: its first touch is the new reference.",
        code="E8056",
    )


def tool_not_of_run(*, problem: object) -> PreconditionError:
    return PreconditionError(
        f"{problem}.",
        hint="Only the tool that began a hole can measure its own wear by touching. Machine it at another place or on new work.",
        code="E8056",
    )


def controller_restarted_since_run(
    *, run_id: object, x_um: object, stages_by_hand: object
) -> PreconditionError:
    return PreconditionError(
        f"The controller was restarted since {run_id}; the run was last seen at {x_um}.",
        hint=f"{stages_by_hand} Then confirm that with --homed.",
        code="E8057",
    )


def bench_of_run_missing(*, file: object, run_id: object, serial: object, port: object) -> PreconditionError:
    return PreconditionError(
        f"There is no bench {file}: {run_id} ran on {serial} at {port}.",
        hint="Name the file of that bench with --port sim:FILE.",
        code="E8058",
    )


def machine_of_run_not_named(*, run_id: object, serial: object, port: object) -> PreconditionError:
    return PreconditionError(
        f"No machine was named, and a fresh virtual one has no work that was begun: {run_id} ran on {serial} at {port}.",
        hint=f"Say --port {port}.",
        code="E8058",
    )


def reference_under_other_setup(
    *, tool: object, folder: object, words: object, differences: object, reference_command: object
) -> PreconditionError:
    return PreconditionError(
        f"The reference of {tool} in {folder} was touched under another setup; with the {words} {differences}.",
        hint=f"Name its setup with --setup or EDMCTL_SETUP. If the machine was changed, touch the pad anew with `{reference_command}`; keep the runs of another machine in another folder with --out.",
        code="E8059",
    )


def depth_contradicts_journal(
    *,
    site: object,
    place: object,
    depth_um: object,
    expected_um: object,
    otherwise: object,
    stages_by_hand: object,
) -> PreconditionError:
    return PreconditionError(
        f"{site} at {place} is {depth_um} µm deep; the journal expects {expected_um} µm.",
        hint=f"Put the workpiece back as it was. {otherwise} {stages_by_hand}",
        code="E8060",
    )


def wear_contradicts_journal(*, wear_um: object, expected_um: object) -> PreconditionError:
    return PreconditionError(
        f"The tool is {wear_um} µm shorter than before the hole; the journal expects {expected_um} µm.",
        hint="It was changed or seated anew, and only the tool that began a hole can tell its own wear by touching. Machine another hole, at another place.",
        code="E8061",
    )


def restart_hole_in_channel(*, run_id: object) -> PreconditionError:
    return PreconditionError(
        f"{run_id} machines a channel, and --restart-hole makes holes anew.",
        hint="Leave --restart-hole out; on fresh work, order the channel as a job of its own.",
        code="E8062",
    )


def no_hole_to_restart(*, run_id: object) -> PreconditionError:
    return PreconditionError(
        f"{run_id} has begun no hole that could be made anew; the next one is machined from its face anyway.",
        hint="Leave --restart-hole out.",
        code="E8062",
    )


def face_not_untouched(*, site: object, depth_um: object) -> PreconditionError:
    return PreconditionError(
        f"There is no untouched face at {site}: it is {depth_um} µm deep.",
        hint="Go on with the hole without --restart-hole, or put untouched work in.",
        code="E8062",
    )


def recipe_of_tool_unreadable(*, path: object, why: object) -> PreconditionError:
    return PreconditionError(
        f"{path} has the recipe that the tool was used with, and cannot be read: {why}",
        hint="Name it with --profile.",
        code="E8063",
    )


def matplotlib_missing(*, install: object) -> PreconditionError:
    return PreconditionError(
        "Figures need matplotlib, which is not installed.", hint=f"Install it: {install}.", code="E8090"
    )


def nothing_to_draw(*, problem: object, remedy: object) -> PreconditionError:
    return PreconditionError(f"{problem}", hint=f"{remedy}", code="E8091")


def pyarrow_missing(*, install: object) -> PreconditionError:
    return PreconditionError(
        "Parquet needs pyarrow, which is not installed.",
        hint=f"Install it: {install}; --format csv needs nothing.",
        code="E8092",
    )


def board_compiler_missing(*, missing: object, install: object) -> PreconditionError:
    return PreconditionError(
        f"Not installed: {missing}.",
        hint=f"Install ziglang: {install}; or, for --compiler gcc, on Debian and Ubuntu `sudo apt install gcc-arm-none-eabi`.",
        code="E8093",
    )


def zig_does_not_run(*, problem: object, install: object) -> PreconditionError:
    return PreconditionError(
        f"{problem}", hint=f"Install it again: {install}; or use --compiler gcc.", code="E8093"
    )


def no_compiler(*, install: object) -> PreconditionError:
    return PreconditionError(
        "There is no C compiler to build the controller and the virtual machine with.",
        hint=f"{install} brings one; CC names another.",
        code="E8093",
    )


def compiler_unusable(*, command: object, error: object) -> PreconditionError:
    return PreconditionError(
        f"The C compiler {command} does not run: {error}.",
        hint="Name another one in CC, or unset it: then one of the system is taken.",
        code="E8093",
    )


def image_not_built(*, reason: object) -> PreconditionError:
    return PreconditionError(
        f"The image could not be built: {reason}", hint="Name another compiler with --compiler.", code="E8094"
    )


def library_not_built(*, reason: object, cache_variable: object) -> PreconditionError:
    return PreconditionError(
        f"The library of the controller and the virtual machine could not be built: {reason}",
        hint=f"Name another C compiler in CC, or a folder that can be written in {cache_variable}.",
        code="E8094",
    )


def sources_missing(*, filename: object, reason: object, install: object) -> PreconditionError:
    return PreconditionError(
        f"The C sources of edmctl are absent or cannot be read: {filename}: {reason}.",
        hint=f"Install edmctl again: {install}.",
        code="E8094",
    )


def library_not_kept(*, parent: object, reason: object, cache_variable: object) -> PreconditionError:
    return PreconditionError(
        f"The compiled library cannot be kept in {parent}: {reason}.",
        hint=f"Name a folder that can be written in {cache_variable}.",
        code="E8094",
    )


def emulator_missing() -> PreconditionError:
    return PreconditionError(
        "There is no emulator of the board here.",
        hint='It runs from a source tree with `pip install -e ".[emulator]"`.',
        code="E8095",
    )


def clock_wrong() -> PreconditionError:
    return PreconditionError(
        "The clock of this computer is wrong: it is later than the year 2262.",
        hint="Set it (`timedatectl` shows it), then run the command again.",
        code="E8096",
    )


def flash_tool_missing(*, missing: object, tool: object, install: object) -> PreconditionError:
    return PreconditionError(
        f"Not installed: {missing}.",
        hint=f"Install {tool}: {install}; without --tool any installed one is used.",
        code="E8120",
    )


def probe_not_found(*, tool: object) -> PreconditionError:
    return PreconditionError(
        f"{tool} finds no board.", hint="Plug in the USB cable of the ST-LINK.", code="E8121"
    )


def probe_access_denied(*, tool: object) -> PreconditionError:
    return PreconditionError(
        f"{tool} may not open the board's USB port.",
        hint="Install the udev rules of the tool; on Linux its package brings them.",
        code="E8121",
    )


def several_probes(*, tool: object) -> PreconditionError:
    return PreconditionError(
        f"{tool} finds several boards.", hint="Unplug the others, or name one with --probe ID.", code="E8121"
    )


def probe_of_another_board(*, port: object, serial: object, probe: object) -> PreconditionError:
    return PreconditionError(
        f"{port} belongs to the ST-LINK {serial}, and --probe names {probe}: another board.",
        hint="Leave --probe out, or name the port of that board.",
        code="E8121",
    )


def chip_not_found(*, tool: object) -> PreconditionError:
    return PreconditionError(
        f"{tool} finds the ST-LINK, and no chip behind it.",
        hint="Check the supply of the board and its jumpers (on a NUCLEO: both of CN4 closed).",
        code="E8121",
    )


def image_for_unknown_board(*, facts: object, board: object) -> PreconditionError:
    return PreconditionError(
        f"{facts} is for board {board}, which this edmctl does not know.",
        hint="Flash it with the edmctl that it was made by.",
        code="E8122",
    )


def image_for_another_board(*, title: object, chip: object, found: object) -> PreconditionError:
    return PreconditionError(
        f"The image is for {title} ({chip}), and the chip there is {found}. Nothing was written.",
        hint="Plug in the right board, or say which one with --probe ID.",
        code="E8122",
    )


def state_of_controller_unknown(*, port: object) -> PreconditionError:
    return PreconditionError(
        f"The controller at {port} does not tell its state: a job may run.",
        hint="End the job, see that the machine rests, and flash without --port.",
        code="E8123",
    )


def controller_busy(*, port: object, state: object) -> PreconditionError:
    return PreconditionError(
        f"The controller at {port} is in state {state}: a job runs.",
        hint="Let it end, or stop it with Ctrl-C where it runs; then flash.",
        code="E8123",
    )


def high_voltage_unconfirmed() -> PreconditionError:
    return PreconditionError(
        "Nobody has said that the high voltage is off.",
        hint="Switch it off, see that its meter shows nothing, and flash again with --yes-high-voltage-is-off.",
        code="E8124",
    )


def high_voltage_on() -> PreconditionError:
    return PreconditionError(
        "The high voltage may be on; nothing was written.",
        hint="Switch it off, see that its meter shows nothing, and flash again with --yes-high-voltage-is-off.",
        code="E8124",
    )


def chip_unknown(*, tool: object, output: object) -> PreconditionError:
    return PreconditionError(
        f"{tool} does not report the chip:\n{output}", hint="Name another tool with --tool.", code="E8125"
    )


def flash_tool_unusable(*, name: object, what: object) -> PreconditionError:
    return PreconditionError(f"{name} {what}.", hint="Name another one with --tool.", code="E8125")


def flash_tool_failed(*, name: object, status: object, command: object, output: object) -> PreconditionError:
    return PreconditionError(
        f"{name} ended with {status}: `{command}`\n{output}",
        hint="The flash may be half written: flash it again, or name another tool with --tool.",
        code="E8125",
    )


def flash_differs(*, read_count: object, address: int) -> PreconditionError:
    return PreconditionError(
        f"{read_count} bytes were read back, and they differ from the image at 0x{address:08X}. The board was not reset.",
        hint="Flash it again, with another tool or cable; a flash that stays wrong is worn.",
        code="E8126",
    )


def study_is_running(*, path: object, command: object) -> PreconditionError:
    return PreconditionError(
        f"Another command is running the study in {path}.",
        hint=f"Wait for it, or stop it; `{command}` prints its progress.",
        code="E8201",
    )


def study_file_changed(*, path: object) -> PreconditionError:
    return PreconditionError(
        f"{path} is not what it was when the study began.",
        hint="Put it back as it was; a changed study is a new one, in another folder.",
        code="E8202",
    )


def plan_of_another_version(*, path: object, made_by: object) -> PreconditionError:
    return PreconditionError(
        f"{path} is not a plan of this version of edmctl.",
        hint=f"Open the folder with the version that made it ({made_by}), or plan the study into a new folder.",
        code="E8202",
    )


def recipe_of_run_differs(*, number: object) -> PreconditionError:
    return PreconditionError(
        f"The recipe of run {number} is not the one that was planned.",
        hint="Another version of edmctl reads the profile in another way: go on with the version that began the study, or plan it anew in another folder.",
        code="E8203",
    )


def tool_change_due(*, tool: object, holes: object, number: object, value: object) -> PreconditionError:
    return PreconditionError(
        f"Tool {tool} has made its {holes}; run {number} is of the next one.",
        hint=f"Change or dress it, and go on with `{value} --new-tool`.",
        code="E8204",
    )


def run_not_approved(*, number: object, value: object) -> PreconditionError:
    return PreconditionError(
        f"Run {number} is not approved.", hint=f"Approve it and go on: `{value} --yes`.", code="E8205"
    )


def study_without_runs(*, folder: object) -> PreconditionError:
    return PreconditionError(
        "No run of the study is done yet.",
        hint=f"Make them with `edmctl study resume {folder}`.",
        code="E8206",
    )


def grid_full() -> PreconditionError:
    return PreconditionError(
        "No place of the study's grid is free any more.",
        hint="A study on new work is another one, in another folder; give its grid more columns or rows.",
        code="E8207",
    )


def grid_too_small(*, places: object, runs: object) -> PreconditionError:
    return PreconditionError(
        f"The study's grid has {places} left beside those of the runs to make, and {runs} need one each.",
        hint="Add fewer runs; a study on new work is another one, in another folder.",
        code="E8207",
    )


def no_point_with_values(*, names: object) -> PreconditionError:
    return PreconditionError(
        f"No point has a value of {names}.",
        hint="Tell manual responses with `edmctl study tell`, or make the runs.",
        code="E8208",
    )


def no_point_known_to_keep(*, limits: object) -> PreconditionError:
    return PreconditionError(
        f"No point is known to keep {limits} by its 95 % bound.",
        hint="Add replicates with `edmctl study extend`, or runs with `edmctl study suggest --add`.",
        code="E8208",
    )


def study_without_objective() -> PreconditionError:
    return PreconditionError(
        "The study has no objective.",
        hint="Add [[objectives]] with a response to the study file, and plan it anew.",
        code="E8209",
    )


def too_few_runs_to_suggest(*, runs: object, least_runs: object, remedy: object) -> PreconditionError:
    return PreconditionError(
        f"{runs} of {least_runs} that a suggestion needs have a value of every objective.",
        hint=f"{remedy}",
        code="E8210",
    )


def suggestions_all_refused() -> PreconditionError:
    return PreconditionError(
        "The rules of recipes refuse whatever is suggested.",
        hint="Narrow the factors: `edmctl study plan` tells which settings are refused.",
        code="E8211",
    )


def dask_missing(*, install: object) -> PreconditionError:
    return PreconditionError("dask is not installed.", hint=f"Install it with {install}.", code="E8212")


def dask_scheduler_silent(*, address: object, reason: object) -> PreconditionError:
    return PreconditionError(
        f"No dask scheduler answers at {address}: {reason}.",
        hint="Start one with `dask scheduler`, and workers with `dask worker ADDRESS`.",
        code="E8212",
    )


def dask_without_workers(*, address: object) -> PreconditionError:
    return PreconditionError(
        f"The scheduler at {address} has no workers.", hint="Start one: `dask worker ADDRESS`.", code="E8212"
    )


def dask_scheduler_gone(*, address: object) -> PreconditionError:
    return PreconditionError(
        f"The dask scheduler at {address} is gone.",
        hint="What is finished is kept. Start a scheduler, and go on with `edmctl study resume`.",
        code="E8212",
    )


def another_machine_answers(*, found: object, wanted: object) -> PreconditionError:
    return PreconditionError(
        f"The machine that answers is {found}, and the runs before were made on {wanted}.",
        hint="Connect that one again: places and tool are known of it alone.",
        code="E8214",
    )


def study_bench_gone(*, bench: object) -> PreconditionError:
    return PreconditionError(
        f"The bench that has made runs of the study, {bench}, is gone; a new one is another machine.",
        hint="Put the file back where it was; a study on another machine is another one, in another folder.",
        code="E8214",
    )


def suggested_run_not_measured(
    *, number: object, names: object, command: object, making_command: object
) -> PreconditionError:
    return PreconditionError(
        f"Run {number} was suggested and waits for {names}: nothing follows from it before.",
        hint=f"Measure it: `{command}`, then go on with `{making_command}`.",
        code="E8216",
    )


def nothing_left_to_suggest(*, what: object, state: object, remedy: object) -> PreconditionError:
    return PreconditionError(f"Nothing is left to {what}.{state}", hint=f"{remedy}", code="E8217")


def workers_end_early() -> PreconditionError:
    return PreconditionError(
        "Worker processes end before they begin: each imports the main module of this program.",
        hint='Put its calls under `if __name__ == "__main__":` in a file, or use one worker.',
        code="E8218",
    )


def statsmodels_missing(*, install: object) -> PreconditionError:
    return PreconditionError(
        "The analysis of a study needs statsmodels.", hint=f"Install it with {install}.", code="E8219"
    )


def run_file_exists(*, existing: object) -> RunFileError:
    return RunFileError(
        f"Run file {existing} exists already and is not overwritten.",
        hint="Choose another name with --run-id, or another folder with --out.",
        code="E9001",
    )


def recovery_target_exists(*, target: object) -> RunFileError:
    return RunFileError(
        f"{target} exists already and is not overwritten.",
        hint="Name another file with --out FILE.",
        code="E9001",
    )


def run_file_not_created(*, path: object, why: object) -> RunFileError:
    return RunFileError(
        f"Cannot create the run file {path}: {why}.",
        hint="Check that the folder given with --out exists, can be written and has space.",
        code="E9002",
    )


def run_not_recovered(*, path: object, target: object, error: object) -> RunFileError:
    return RunFileError(
        f"Cannot recover {path} into {target}: {error}.",
        hint="Check that its folder can be written and has space, or name another file with --out.",
        code="E9002",
    )


def run_file_not_written(*, partial: object, error: object) -> RunFileError:
    return RunFileError(
        f"Cannot write {partial}: {error}.",
        hint=f"Free some space or choose another folder with --out; `edmctl run recover {partial}` then saves what was recorded before.",
        code="E9003",
    )


def run_file_not_named(*, target: object, why: object, remedy: object) -> RunFileError:
    return RunFileError(f"Cannot name the run file {target}: {why}.", hint=f"{remedy}", code="E9004")


def folder_or_run_missing(*, folder: object) -> RunFileError:
    return RunFileError(
        f"There is neither a folder nor a run {folder}.",
        hint="Give the folder that the runs were written to (--out), or the id of a run in runs/.",
        code="E9005",
    )


def run_file_unreadable(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"{path} cannot be read: {reason}.", hint="Check the path and its permissions.", code="E9005"
    )


def not_a_run_file(*, path: object, what: object) -> RunFileError:
    return RunFileError(
        f"{path} {what}.", hint="Give a file that a run has written (.h5 or .h5.partial).", code="E9005"
    )


def run_file_is_folder(*, path: object) -> RunFileError:
    return RunFileError(f"{path} is a folder.", hint=f"Try `edmctl run list {path}`.", code="E9005")


def run_file_missing(*, path: object, remedy: object) -> RunFileError:
    return RunFileError(f"There is no run file {path}.", hint=f"{remedy}", code="E9005")


def folder_unreadable(*, folder: object, reason: object) -> RunFileError:
    return RunFileError(
        f"The folder {folder} cannot be read: {reason}.",
        hint="Give the folder that the runs were written to (--out).",
        code="E9005",
    )


def run_file_of_later_version(*, path: object, schema: object, own_schema: object) -> RunFileError:
    return RunFileError(
        f"{path} was written by a later version of edmctl ({schema}; this one reads {own_schema}).",
        hint="Update edmctl.",
        code="E9006",
    )


def run_file_of_earlier_version(
    *, path: object, maker: object, schema: object, own_schema: object
) -> RunFileError:
    return RunFileError(
        f"{path} was written by edmctl {maker}, an earlier version ({schema}; not {own_schema}).",
        hint="Read it with that version; its `edmctl run export` writes tables for other programs.",
        code="E9006",
    )


def run_file_damaged(*, path: object, why: object) -> RunFileError:
    return RunFileError(
        f"{path} is damaged: {why}.",
        hint=f"`edmctl run recover {path}` writes what can still be read into a new file; this one stays as it is.",
        code="E9007",
    )


def run_file_beyond_recovery(*, path: object, why: object) -> RunFileError:
    return RunFileError(
        f"{path} is damaged beyond recovery: {why}.", hint="Take the file from a backup.", code="E9007"
    )


def run_file_without_end(*, path: object) -> RunFileError:
    return RunFileError(
        f"The run in {path} was interrupted: its file has no end.",
        hint=f"`edmctl run recover {path}` makes a complete file of what was recorded.",
        code="E9008",
    )


def disk_too_slow(*, path: object, still_s: float, waiting_mb: float) -> RunFileError:
    return RunFileError(
        f"The disk has not taken rows of {path} for {still_s:.0f} s: {waiting_mb:.0f} MB wait.",
        hint=f"Record on a disk that keeps up, with --out; what was recorded before is in {path}.",
        code="E9009",
    )


def disk_does_not_answer(*, give_up_s: float, path: object) -> RunFileError:
    return RunFileError(
        f"The disk has not answered for {give_up_s:.0f} s: {path} is not written.",
        hint="Keep run files on a disk that keeps up, with --out.",
        code="E9009",
    )


def result_not_written(*, reason: object) -> RunFileError:
    return RunFileError(f"Cannot write the result: {reason}.", hint="", code="E9010")


def output_exists(*, path: object, remedy: object) -> RunFileError:
    return RunFileError(f"{path} exists already and is not overwritten.", hint=f"{remedy}", code="E9011")


def use_record_not_removed(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"Cannot remove {path}, which says how the actuator was used: {reason}.",
        hint="Check its permissions, or remove it by hand.",
        code="E9012",
    )


def output_not_written(*, what: object, why: object, remedy: object) -> RunFileError:
    return RunFileError(f"Cannot write {what}: {why}.", hint=f"{remedy}", code="E9012")


def calibration_name_too_long(*, path_count: object, longest_name: object) -> RunFileError:
    return RunFileError(
        f"The name of the calibration file has {path_count} bytes; at most {longest_name} fit.",
        hint="Give --output a shorter name.",
        code="E9012",
    )


def run_still_written(*, path: object) -> RunFileError:
    return RunFileError(
        f"{path} is still being written by a run that goes on.",
        hint="Wait for its end; `edmctl run show --follow` shows how it does.",
        code="E9014",
    )


def nothing_of_that_name(*, problem: object, meant: object, known: object) -> RunFileError:
    return RunFileError(f"{problem}.", hint=f"{meant}There are: {known}.", code="E9015")


def run_file_closed(*, path: object) -> RunFileError:
    return RunFileError(f"{path} has been closed.", hint="Read it inside the `with` block.", code="E9015")


def not_a_table_of_rows(*, path: object) -> RunFileError:
    return RunFileError(
        f"{path} is no table of rows.",
        hint=f"Its columns are arrays of their own: columns({path!r}).",
        code="E9015",
    )


def run_file_in_use(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"{path} is in use: {reason}.", hint="Close it in that program, or read a copy.", code="E9016"
    )


def bench_unreadable(*, path: object, why: object) -> RunFileError:
    return RunFileError(
        f"The bench {path} cannot be read: {why}.",
        hint="Give the file of a bench, or a name that is free for a new one.",
        code="E9020",
    )


def bench_of_earlier_version(*, path: object) -> RunFileError:
    return RunFileError(
        f"{path} is of an earlier version, whose work and tool eroded by other laws.",
        hint="Use the version of edmctl that wrote it, or give a name that is free for a new bench.",
        code="E9021",
    )


def saved_bench_does_not_fit(*, kind: object, error: object) -> RunFileError:
    return RunFileError(
        f"The saved bench does not fit this version: {kind} {error}.",
        hint="Use the version of edmctl that wrote the file, or begin a new bench under another name.",
        code="E9021",
    )


def bench_of_later_version(*, path: object, schema: object, own_schema: object) -> RunFileError:
    return RunFileError(
        f"The bench {path} was written by a later edmctl: schema {schema}, this one knows {own_schema}.",
        hint="Use that version of edmctl, or begin a new bench under another name.",
        code="E9022",
    )


def bench_in_use(*, path: object, holder: object) -> RunFileError:
    return RunFileError(
        f"The bench {path} is in use: {holder}.",
        hint="Let the other program end (--wait SECONDS waits for it), or take another file.",
        code="E9023",
    )


def bench_not_kept(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"Cannot keep the bench {path}: {reason}.",
        hint="Check that the folder exists, can be written and has space.",
        code="E9024",
    )


def ledger_unreadable(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"The job ledger {path} cannot be read: {reason}.",
        hint="Close the program that has locked it, check its permissions, or give another --out.",
        code="E9030",
    )


def ledger_line_damaged(*, path: object, number: object, error: object) -> RunFileError:
    return RunFileError(
        f"{path}:{number}: this line of the job ledger is damaged: {error}.",
        hint="Take the line out with an editor if you know what it said, or keep run files elsewhere with --out.",
        code="E9031",
    )


def ledger_line_of_later_version(
    *, path: object, number: object, later: object, version: object
) -> RunFileError:
    return RunFileError(
        f"{path}:{number}: a later edmctl wrote this line (version {later}; this one knows {version}).",
        hint="Use that version of edmctl, or keep run files elsewhere with --out.",
        code="E9032",
    )


def ledger_not_written(*, path: object, why: object) -> RunFileError:
    return RunFileError(
        f"Cannot write the job ledger {path}: {why}.",
        hint="Check that the folder can be written and has space.",
        code="E9033",
    )


def journal_not_kept(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"Cannot keep the journal {path}: {reason}.",
        hint="Check that the folder given with --out can be written and has space.",
        code="E9040",
    )


def journal_unreadable(*, path: object, reason: object) -> RunFileError:
    return RunFileError(
        f"The journal {path} cannot be read: {reason}.", hint="Check its permissions.", code="E9041"
    )


def study_folder_not_empty(*, path: object) -> RunFileError:
    return RunFileError(f"{path} is not empty.", hint="Choose another folder with --out.", code="E9101")


def folder_has_a_study(*, path: object, quoted_path: object) -> RunFileError:
    return RunFileError(
        f"{path} has a study already.",
        hint=f"Continue it with `edmctl study resume {quoted_path}`, or choose another folder with --out.",
        code="E9101",
    )


def row_not_written(*, folder: object, reason: object) -> RunFileError:
    return RunFileError(
        f"Cannot write a row into {folder}: {reason}.",
        hint="Check folder and space, and go on: rows that are there are kept.",
        code="E9110",
    )


def study_folder_not_locked(*, path: object, reason: object) -> RunFileError:
    return RunFileError(f"Cannot lock {path}: {reason}.", hint="Check the folder.", code="E9110")


def rows_unreadable(*, file: object, reason: object) -> RunFileError:
    return RunFileError(
        f"Cannot read the rows in {file}: {reason}.",
        hint="Check its permissions; a file that no study has written does not belong there.",
        code="E9111",
    )


def sweep_on_one_machine(*, seed: object) -> Diagnostic:
    return Diagnostic(
        "W2003",
        f"Every value of the sweep runs on the one machine of seed {seed}: its sensor errs alike in all.",
        "What the runs have in common does not show as a difference; --runs 4 or more shows how machines differ.",
        is_warning=True,
    )


def record_doubtful(*, doubt: object) -> Diagnostic:
    return Diagnostic("W3610", f"{doubt}", "", is_warning=True)


def telemetry_lost(*, lost_frames: object) -> Diagnostic:
    return Diagnostic(
        "W3611",
        f"{lost_frames} frames of telemetry were lost on the line.",
        "Turning points may be missing: look at the line, and calibrate again.",
        is_warning=True,
    )


def calibration_not_accepted(*, problem: object) -> Diagnostic:
    return Diagnostic(
        "W3650",
        f"Not accepted: {problem}",
        "`edmctl machine` uses such a calibration, and warns each time.",
        is_warning=True,
    )


def validation_beyond_fit(
    *, record: object, low_v: float, high_v: float, fitted_low_v: float, fitted_high_v: float
) -> Diagnostic:
    return Diagnostic(
        "W3651",
        f"{record} goes from {low_v:.4g} V to {high_v:.4g} V, the records that were fitted from {fitted_low_v:.4g} V to {fitted_high_v:.4g} V: beyond, the model guesses.",
        "Fit records over the whole range that will be used.",
        is_warning=True,
    )


def calibration_in_use_stays(*, path: object) -> Diagnostic:
    return Diagnostic(
        "W3652",
        f"The calibration in use stays: the new one was not accepted, and is in {path}.",
        "Put right what it says, and calibrate again; --calibration FILE uses it all the same.",
        is_warning=True,
    )


def measured_data_lost() -> Diagnostic:
    return Diagnostic(
        "W3660",
        "What was measured is lost: it could not be written beside the calibration, nor here.",
        "Make room, and calibrate again.",
        is_warning=True,
    )


def measured_data_kept(*, kept: object) -> Diagnostic:
    return Diagnostic(
        "W3660",
        f"What was measured is kept in {kept}.",
        f"Fit it again with `edmctl calibrate --from {kept}`.",
        is_warning=True,
    )


def seed_without_effect_on_bench(*, seed: object, file: object) -> Diagnostic:
    return Diagnostic(
        "W4101",
        f"Seed {seed} has no effect on the bench that {file} keeps already.",
        "Leave it out, or name a new file for another machine.",
        is_warning=True,
    )


def seed_without_effect_at_port(*, seed: object, port: object) -> Diagnostic:
    return Diagnostic(
        "W4101",
        f"Seed {seed} has no effect on the controller at {port}.",
        "Give the seed to `edmctl simulate serve` where the controller is a virtual one.",
        is_warning=True,
    )


def controller_option_without_effect(*, asked: object, selector: object) -> Diagnostic:
    return Diagnostic(
        "W4102",
        f"--controller {asked} has no effect on the controller at {selector}.",
        "Give it to `edmctl simulate serve` where the controller is a virtual one.",
        is_warning=True,
    )


def image_of_another_version(*, image: object, schema_hash: object, own_hash: object) -> Diagnostic:
    return Diagnostic(
        "W5001",
        f"{image} speaks schema {schema_hash}, this edmctl {own_hash}.",
        "Build the image of this edmctl: `edmctl firmware build --board stm32f4`.",
        is_warning=True,
    )


def calibration_of_another(*, path: object, owner: object, serial: object) -> Diagnostic:
    return Diagnostic(
        "W8101",
        f"{path} is of {owner}; this machine is {serial}.",
        "Every actuator is another one: run `edmctl calibrate` here.",
        is_warning=True,
    )


def calibration_of_another_seed(*, path: object, owner: object, serial: object) -> Diagnostic:
    return Diagnostic(
        "W8101",
        f"{path} is of {owner}; this actuator is that of {serial}.",
        "Say the --seed it was made with, or leave --calibration out.",
        is_warning=True,
    )


def unaccepted_calibration(*, path: object, problems: object) -> Diagnostic:
    return Diagnostic(
        "W8102", f"{path} was not accepted: {problems}", "Run `edmctl calibrate` again.", is_warning=True
    )


def trial_calibration_not_accepted(*, problem: object) -> Diagnostic:
    return Diagnostic(
        "W8102",
        f"The calibration was not accepted: {problem}",
        "The figures show what it costs.",
        is_warning=True,
    )


def waveform_too_steep(*, waveform: object, slew_v_s: float, worst_v: float) -> Diagnostic:
    return Diagnostic(
        "W8103",
        f"{waveform} is steeper than the machine's {slew_v_s:g} V/s; the voltage applied is up to {worst_v:.1f} V away from it.",
        "All figures are for the voltage that was applied.",
        is_warning=True,
    )


def calibration_too_narrow(*, path: object, low_v: float, high_v: float, top_v: float) -> Diagnostic:
    return Diagnostic(
        "W8104",
        f"{path} covers {low_v:.1f} V to {high_v:.1f} V; limits.stroke_v_max is {top_v:.1f} V. Beyond it the model guesses.",
        "Calibrate from 0 V over the whole stroke.",
        is_warning=True,
    )


def waveform_beyond_calibration(
    *, waveform: object, way: object, end_v: float, calibrated_v: float
) -> Diagnostic:
    return Diagnostic(
        "W8104",
        f"{waveform} goes {way} to {end_v:.1f} V and the calibration to {calibrated_v:.1f} V.",
        "Calibrate over the whole stroke.",
        is_warning=True,
    )


def no_sensor(
    *, rms_um: float, max_um: float, gain_sd_between_days: float, load_um_per_n: float
) -> Diagnostic:
    return Diagnostic(
        "W8105",
        f"No sensor: every displacement is estimated, within {rms_um:.2f} µm rms and {max_um:.1f} µm at most when calibrated, {gain_sd_between_days:.1f} % of gain on another day, and {load_um_per_n:g} µm per newton at the tool.",
        "The stated uncertainties of depth and wear hold the first two; fit a sensor where they are too wide.",
        is_warning=True,
    )


def drift_file_of_another(*, path: object, owner: object, serial: object) -> Diagnostic:
    return Diagnostic(
        "W8106",
        f"{path} is of {owner}; this machine is {serial}.",
        "Drift is not corrected in this run. Run `edmctl measure-drift` here.",
        is_warning=True,
    )


def drift_file_outdated(*, path: object, what: object) -> Diagnostic:
    return Diagnostic(
        "W8107",
        f"{path} {what}.",
        "Drift is not corrected in this run. Run `edmctl measure-drift` here.",
        is_warning=True,
    )


def actuator_use_unknown(*, unknown_use_s: object) -> Diagnostic:
    return Diagnostic(
        "W8108",
        f"How the actuator was used until {unknown_use_s} ago is unknown: a command was killed, stopped, or followed no creep. Where the rests tell less of the drift than the setup does, nothing is corrected.",
        "Half an hour of rest mends it; the next run knows what this one leaves.",
        is_warning=True,
    )


def calibration_restricted(*, path: object, restrictions: object) -> Diagnostic:
    return Diagnostic(
        "W8109",
        f"{path} was accepted {restrictions}",
        "Calibrate with swings of several rates and holds, as `edmctl calibrate` drives them.",
        is_warning=True,
    )


def tool_will_wear_out(*, lost: object, tool_wear_um: object, limit_um: object, plan: object) -> Diagnostic:
    return Diagnostic(
        "W8110",
        f"{lost}; the whole job takes {tool_wear_um}, of {limit_um} in all.",
        f"The job will stop in order before a hole that the tool cannot make. {plan}",
        is_warning=True,
    )


def reference_at_another_speed(*, speed_um_s: float, speed_now_um_s: float) -> Diagnostic:
    return Diagnostic(
        "W8111",
        f"The reference was touched at {speed_um_s:g} µm/s, measure.speed_um_s is {speed_now_um_s:g} µm/s: creep enters the two differently.",
        f"Say --set measure.speed_um_s={speed_um_s:g}.",
        is_warning=True,
    )


def tool_shorter_than_expected(*, wear_um: object, worn_um: object, u95_um: object) -> Diagnostic:
    return Diagnostic(
        "W8112",
        f"The tool is {wear_um} shorter than at its reference; its jobs account for {worn_um}. They differ by more than {u95_um}.",
        "If the tool was changed or moved, say --reference; a hole that was left unmeasured explains less.",
        is_warning=True,
    )


def reference_not_kept() -> Diagnostic:
    return Diagnostic(
        "W8113",
        "The reference is not kept: a fresh virtual machine is gone with this command.",
        "Say --port sim:FILE for one that stays.",
        is_warning=True,
    )


def reference_without_profile(*, run_file: object, label: object) -> Diagnostic:
    return Diagnostic(
        "W8114",
        f"The reference in {run_file} was touched without a profile; it is not that of {label}.",
        f"{label} takes the first touch of its job for one; `edmctl measure-wear --reference --profile NAME` says whose a reference is.",
        is_warning=True,
    )


def interrupted_run_of_tool(*, run_file: object, tool: object, command: object) -> Diagnostic:
    return Diagnostic(
        "W8115",
        f"{run_file} was interrupted and cannot be finished once {tool} has done another job.",
        f"Stop this job and finish that one first, with `{command}`.",
        is_warning=True,
    )


def bench_new_for_ledger(*, ledger: object, serial: object) -> Diagnostic:
    return Diagnostic(
        "W8116",
        f"The bench is new, and the ledger {ledger} knows another {serial}: its holes and the wear of its tools count for this one.",
        "Keep the runs of a new bench in another folder (--out), or give it another --seed.",
        is_warning=True,
    )


def reference_replaced(
    *, label: object, z_um: object, before_um: object, run_file: object, worn_um: object
) -> Diagnostic:
    return Diagnostic(
        "W8117",
        f"Z1 of {label} is {z_um} now and replaces {before_um} of {run_file}: the {worn_um} that its jobs have worn since can no longer be measured.",
        "If the touch was meant for another tool, name that with --profile and touch again.",
        is_warning=True,
    )


def study_of_another_version(*, version: object, own_version: object) -> Diagnostic:
    return Diagnostic(
        "W8203",
        f"The study began with edmctl {version}; this is {own_version}.",
        "Compare runs of both versions with care, or go on with the version that began it.",
        is_warning=True,
    )


def study_on_virtual_machines() -> Diagnostic:
    return Diagnostic(
        "W8215",
        "The study has a [machine], and no port is named: its runs are made on virtual machines.",
        "Name the machine with --port; runs of both are never mixed.",
        is_warning=True,
    )


def earlier_run_not_recovered(*, message: object, partial: object) -> Diagnostic:
    return Diagnostic(
        "W9001",
        f"The file of the run before could not be recovered: {message}",
        f"The job goes on all the same. Try `edmctl run recover {partial}` later.",
        is_warning=True,
    )


def no_file_locks(*, folder: object) -> Diagnostic:
    return Diagnostic(
        "W9002",
        f"The file system of {folder} has no file locks: nothing prevents two commands from writing there at once.",
        "Run one command at a time, or name a folder on another disk with --out.",
        is_warning=True,
    )
