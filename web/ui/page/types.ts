// The JSON of web/src/page.rs and web/src/bus.rs.

export interface Output {
  pin: string;
  width_us: number | null;
  /** Index of the motor in RawCommand; null for a servo. */
  motor: number | null;
  /** The autopilot's present command: -1 to 1, of a motor 0 to 1. */
  command: number;
}

export interface Parameter {
  name: string;
  kind: "integer" | "real" | "boolean" | "text" | "none";
  /** Values as a user writes them. */
  value: string | null;
  min: string | null;
  max: string | null;
  default: string | null;
}

/** A tool that asks a node (web/src/dialogue.rs). */
export interface Client {
  busy: boolean;
  message: string;
  info: string | null;
  /** What of the last file the node has not, and why. */
  problems: string[];
  parameters: Parameter[];
}

export interface Snapshot {
  now: number;
  autopilot: {
    name: string;
    command_type: string;
    deflection: number;
    sweeps: boolean;
    armed: boolean;
    safe: boolean;
  };
  outputs: Output[];
  /** Those of the second board; empty without one. */
  second: Output[];
  light: number;
  sensor_c: number;
  node_c: number | null;
  node: {
    id: number;
    silent_s: number;
    health: string;
    mode: string;
    uptime_s: number;
    vendor_code: number;
    /** A condition in words, and what to do. */
    conditions: [string, string][];
  } | null;
  controller: {
    mode: string;
    error_state: string;
    tec: number;
    rec: number;
    lost: number;
    worst_us: number;
  };
  client: Client;
  faults: string[];
  load: number;
  frames: number;
  error_frames: number;
  bit_rate: number;
  crash: string | null;
}

/** What is wired to what (`Page::wiring`): pins of the Arduino, and titles. */
export interface Wiring {
  text: string;
  /** Values of the chips that are not typical; empty if all are. */
  corner: string;
  board: string;
  chip: string;
  shield: string;
  /** False for a shield, which is plugged on. */
  is_wired: boolean;
  crystal_mhz: number;
  cs: string;
  int: string;
  sensor: string;
  light: string | null;
  button: string | null;
}

export interface FrameEvent {
  kind: "frame";
  number: number;
  frame: "transfer" | "part" | "foreign" | "error";
  from: string;
  text: string;
  name: string | null;
  start: number;
  end: number;
  /** Of a LogMessage. */
  log?: { node: number | null; level: string; source: string; text: string };
}

export interface TextEvent {
  kind: "line" | "mistake" | "node" | "mark" | "hint";
  at: number;
  text: string;
}

export type PageEvent = FrameEvent | TextEvent;

export interface FrameDetail {
  number: number;
  from: string;
  text: string;
  /** In words: of its start, on the real bus of its arrival. */
  time: string;
  count: number;
  length_us: number;
  wire: {
    frame: string;
    /** In DroneCAN; empty for other frames. */
    meaning: [string, string][];
    fields: [string, string][];
    /** Level (1 is recessive, null is not known), 1 for a stuff bit, index of the field. */
    bits: [number | null, number, number][];
  } | null;
  /** Only of the simulated board. */
  spi?: {
    name: string;
    after_us: number;
    took_us: number;
    mosi: number[];
    miso: number[];
  } | null;
}

export interface Fault {
  name: string;
  text: string;
  lasts: boolean;
}

/** A node on the real bus. */
export interface BusNode {
  id: number;
  name: string | null;
  dialect: "v0" | "draft";
  is_ours: boolean;
  health: string;
  mode: string;
  uptime_s: number;
  vendor_code: number;
  conditions: string[];
  silent_s: number;
  software: string | null;
  hardware: string | null;
  /** False if it says that it takes none over the bus. */
  takes_updates: boolean;
  unique_id: string | null;
}

export interface BusUpdate {
  node: number;
  runs: boolean;
  text: string;
  is_updated?: boolean;
  sent?: number;
  total?: number;
}

export interface BusCheck {
  node: number;
  runs: boolean;
  /** `verdict` is null for what is no row of the report. */
  lines: { text: string; verdict: string | null }[];
  question: string | null;
  /** The rest of the time for what the question asks to do. */
  seconds: number | null;
  summary: string;
  /** What is to be put back if the page is closed now. */
  left: string;
}

/** The state of the real bus. */
export interface BusSnapshot {
  /** "asks" if the adapter cannot only listen, and is to be opened to send only by the user. */
  state: "closed" | "opening" | "asks" | "open";
  trouble: string | null;
  now: number;
  bit_rate: number;
  load: number;
  /** True if the adapter drives no bit, not even an acknowledgement. */
  only_listens: boolean;
  own_id: number | null;
  /** True while the page listens before it takes a node ID. */
  listens_first: boolean;
  received: number;
  sent: number;
  dropped: number;
  echoed: number;
  invalid: number;
  logged: number;
  nodes: BusNode[];
  chosen: number | null;
  client: Client | null;
  updates: BusUpdate[];
  check: BusCheck | null;
}
