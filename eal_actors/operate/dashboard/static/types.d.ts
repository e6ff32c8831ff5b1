// Types of the page: messages of the websocket, entries of the store, and views. Read by tsc only; never served.
// The server's side of the messages is in messages.py (page to server), and in fleet_poller.py, values.py, run_manager.py, log_tap.py,
// world_map.py and dispatcher.py (server to page).

// Messages from the server.

/** x and y in metres, in the world's frame. */
export type Point = [number, number];

/** A point, and when the robot was there by the page's clock, in ms; -Infinity if that was before the connection. */
export type TrailPoint = [number, number, number];

/** The first message of a connection. */
export interface Hello {
  fleet: string;
  robots: string[];
  world: World | null;
  trails: Record<string, Point[]>;
  /** Seconds of the fleet's clock in one real second. */
  rate: number;
  /** The time of the fleet's clock. */
  now_s: number;
  max_cameras: number;
  /** The server's name for this page. */
  you: string;
  /** The operator's name, else how the user got in. */
  user: string;
  role: Role;
  may_command: boolean;
  /** Why this page may not command. */
  why: string | null;
}

/** A plan of an agent that waits for a decision. */
export interface AgentPlan {
  hash: string;
  name: string;
  agent: string;
  text: string;
  parameters: Record<string, Value | Value[]>;
  robots: string[];
  duration_s: number;
}

/** Each includes those before it. */
export type Role = "watch" | "drive" | "run" | "administer";

/** A change of the state, with answers to requests. Lines of a topic may have been dropped. */
export interface Update {
  now_s: number;
  /** A robot that left the fleet is null. */
  robots?: Record<string, Robot | null>;
  poses?: Record<string, Pose>;
  /** Live values of the robot that this page watches, by resource. */
  values?: Record<string, Record<string, LiveValue>>;
  /** The planned path of a robot; null at its end. */
  paths?: Record<string, Point[] | null>;
  run?: { "": Run };
  logs?: LogLine[];
  logs_lost?: number;
  events?: RunEvent[];
  events_lost?: number;
  answers?: (Answer | { drive_error: DriveError })[];
}

export interface DriveError {
  error: string;
  robot?: string;
  /** The number of the key press that has ended. */
  press?: number;
}

export interface Robot {
  type: string | null;
  tags: string[];
  is_remote: boolean;
  resources: string[];
  cameras: string[];
  can_drive: boolean;
  /** Whether it can be sent to a point of the map. */
  can_go: boolean;
  /** Of the smallest disc that it fits in; null if it does not tell. */
  radius_m: number | null;
  /** Where its first camera looks: the angle of view, and its direction from straight ahead; null if unknown. */
  view: { fov_deg: number; yaw_rad: number } | null;
  /** Covariance of its position: of x, of x and y, and of y, in m². */
  spread_m2: [number, number, number] | null;
  state: string;
  /** Why an emergency stop holds the robot. */
  stopped: string | null;
  /** Whether it has halted since; until then it may still move. */
  is_stop_confirmed: boolean;
  /** When a lost robot last answered, in ISO 8601. */
  last_seen: string | null;
  /** When its pose was measured, in ISO 8601, if that was long ago. */
  pose_seen: string | null;
  /** Reasons by resource. */
  not_ready: Record<string, string>;
  problems: string[];
  /** 0 to 1. */
  battery: number | null;
  round_trip_ms: number | null;
  /** Controllers by resource; "" stands for the whole robot. */
  control: Record<string, string>;
  running: RunningCommand[];
  /** The newest step of the run that has not ended. */
  step: { label: string; since_s: number } | null;
  last_error: string | null;
}

export interface RunningCommand {
  resource: string;
  command: string;
  /** The controller; null for this dashboard. */
  by: string | null;
  since_s: number;
  progress: { fraction: number | null; text: string; time_s: number } | null;
}

/** x and y in metres and yaw in radians, and the resource that reported them. */
export interface Pose {
  at: [number, number, number];
  by: string | null;
}

/** The newest value of a resource: none before the first answer. Arrays are flat; null stands for NaN. */
export interface LiveValue {
  value?: Value | (number | boolean | null)[] | null;
  /** When it was measured, by the fleet's clock. */
  stamp_s?: number | null;
  error?: string;
  /** For how long the newest question has had no answer, in seconds; only if that is long. */
  silent_s?: number;
}

export type Run = { phase: "none" } | StartedRun;

export interface StartedRun {
  phase: "running" | "paused" | "ended";
  run: number;
  scenario: string;
  robots: string[];
  calls: number;
  done: number;
  done_by: Record<string, number>;
  started_s: number;
  outcome: string | null;
  error: string | null;
  duration_s?: number;
  /** Path of the report page. */
  report?: string;
}

export interface LogLine {
  at: string;
  level: string;
  robot: string | null;
  resource: string | null;
  text: string;
  details: Record<string, string>;
}

interface ReportedError {
  message: string;
}

/** An event of a run, as in events.jsonl. */
export type RunEvent = { time_s: number } & (
  | { event: "run_started"; scenario: string; robots: string[]; started_s: number }
  | { event: "step_started"; robot: string | null; step: string; label: string }
  | { event: "step_ended"; record: StepRecord }
  | { event: "step_retried"; robot: string | null; label: string; attempt: number; error: ReportedError }
  | { event: "robot_dropped"; robot: string; error: ReportedError }
  | { event: "robot_lost"; robot: string; error: ReportedError }
  | { event: "robot_returned"; robot: string }
  | { event: "robot_replaced"; robot: string; by: string; error: ReportedError }
  | { event: "log"; robot: string | null; text: string }
  | { event: "run_paused" }
  | { event: "run_resumed"; is_single_step: boolean }
  | { event: "run_ended"; report: { outcome: string } }
);

export interface StepRecord {
  robot: string | null;
  step: string;
  label: string;
  start_s: number;
  end_s: number;
  outcome: string;
  error: ReportedError | null;
}

/** The world's shapes, in metres. */
export interface World {
  name: string;
  size_m: [number, number];
  shapes: WorldShape[];
  /** x and y of both ends. */
  posters: [number, number, number, number][];
  /** Corners of keep-out zones. */
  keep_out: Point[][];
  places: { x_m: number; y_m: number; name: string }[];
  /** Colours are red, green and blue of 0 to 255. */
  beacons: { x_m: number; y_m: number; name: string; colour: number[] }[];
}

export type WorldShape = { kind: "drop" | "obstacle" | "box"; x_m: number; y_m: number } & (
  | { radius_m: number }
  | { size_m: [number, number]; yaw_deg: number }
);

/** The header of a binary message; the JPEG follows it. */
export interface FrameHeader {
  robot: string;
  resource: string;
  stamp_s: number | null;
  same_since_s: number | null;
  error: string | null;
}

export interface ResourceDescription {
  name: string;
  types: string[];
  methods: string[];
  description: string;
  value: ValueDescription | null;
  commands: CommandDescription[];
  requests: CommandDescription[];
  configs: ConfigDescription[];
}

export interface ConfigDescription {
  name: string;
  value: ValueDescription;
  writable: boolean;
  description: string;
}

export interface CommandDescription {
  name: string;
  argument: ValueDescription | null;
  returns: ValueDescription | null;
  urgent: boolean;
  description: string;
}

export interface ValueDescription {
  type: string;
  unit: string | null;
  minimum: number | null;
  maximum: number | null;
  choices: (string | number)[];
  /** null stands for any size. */
  shape: (number | null)[];
  description: string;
}

export interface ScenarioEntry {
  file: string;
  name: string;
  problems: string[];
  description?: string | null;
  parameters?: Record<string, Parameter>;
}

export interface Parameter {
  type: string;
  unit: string | null;
  default: Value | Value[] | null;
  minimum: number | null;
  maximum: number | null;
  choices: Value[];
  description: string | null;
}

// Messages to the server.

export type Value = string | number | boolean;
export type Argument = Value | number[] | number[][] | null;

/** Requests, by the word in `do`; each is answered. `heard_s`, the time of the newest update, is added. */
export interface Requests {
  describe: { robot: string };
  scenarios: object;
  call: { robot: string; resource: string; method: string; text?: string; value: Argument };
  /** To several robots; the text `halt` without a resource halts them. */
  command: { robots: string[]; resource: string; text: string; value: Argument };
  send: { robot: string; x_m: number; y_m: number; keep_out: Point[][] };
  stop: object;
  resume: object;
  reload: object;
  start: { file: string; parameters: Record<string, Value | Value[]> };
  plans: object;
  decide: { hash: string; approve: boolean };
  control: { what: string };
}

/** What a successful answer holds. */
export interface Answers {
  describe: { resources: ResourceDescription[] };
  scenarios: { scenarios: ScenarioEntry[] };
  call: { value: string };
  command: { confirmed: string[] };
  send: object;
  stop: { confirmed: string[] };
  resume: { confirmed: string[] };
  reload: { changes: string };
  start: object;
  plans: { plans: AgentPlan[] };
  decide: object;
  control: object;
}

export type RequestName = keyof Requests;

export interface Failure {
  ok: false;
  id?: number | null;
  error?: string;
  problems?: string[];
  /** Reasons by robot, where some robots did not confirm. */
  failed?: Record<string, string>;
}

export type AnswerTo<Name extends RequestName> = ({ ok: true; id: number } & Answers[Name]) | Failure;
export type Answer = AnswerTo<RequestName>;

/** Messages without an answer. */
export type Message =
  | { do: "watch"; cameras: [string, string][]; rate_hz?: number }
  | { do: "watch_values"; robot: string | null }
  | { do: "drive"; robot: string; press: number; speed_m_s: number; turn_rad_s: number; heard_s: number }
  | { do: "release"; robot: string };

// The page.

export type Change = "hello" | "robots" | "poses" | "values" | "run" | "logs" | "events" | "time";

export interface View {
  update(changed: Set<Change>): void;
  leave?(): void;
}

export type Tone = "good" | "warn" | "bad";

/** A current command of a robot, or its current step of a run. */
export interface Activity {
  text: string;
  fraction: number | null;
  note: string;
  by: string | null;
  since_s: number;
}

/** An input field. `read` returns a problem or a value. */
export interface Field<T> {
  node: HTMLElement;
  read(): { problem: string } | { problem: null; value: T };
}

export type Child = Node | string | null | undefined | false;

type ElementOf<Tag extends keyof HTMLElementTagNameMap> = HTMLElementTagNameMap[Tag];

export type Properties<Tag extends keyof HTMLElementTagNameMap> = Partial<
  Omit<ElementOf<Tag>, "style" | "children" | "className">
> & { class?: string } & { [attribute: `aria-${string}` | `data-${string}`]: string };
