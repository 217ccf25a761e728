// The JSON of web/src/page.rs.

export interface Output {
  pin: string;
  width_us: number | null;
}

export interface Parameter {
  name: string;
  value: number | null;
  min: number | null;
  max: number | null;
  default: number | null;
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
    silent: boolean;
  };
  outputs: Output[];
  light: number;
  has_light: boolean;
  has_button: boolean;
  board: string;
  sensor_c: number;
  node_c: number | null;
  node: {
    id: number;
    silent_s: number;
    text: string;
    health: string;
    mode: string;
    uptime_s: number;
    vendor_code: number;
    conditions: string[];
  } | null;
  controller: {
    mode: string;
    error_state: string;
    tec: number;
    rec: number;
    lost: number;
    worst_us: number;
  };
  client: { busy: boolean; message: string; info: string | null; parameters: Parameter[] };
  faults: string[];
  load: number;
  frames: number;
  error_frames: number;
  bit_rate: number;
  crash: string | null;
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
}

export interface TextEvent {
  kind: "line" | "mistake" | "node";
  at: number;
  text: string;
}

export type PageEvent = FrameEvent | TextEvent;

export interface FrameDetail {
  number: number;
  from: string;
  text: string;
  start: number;
  end: number;
  count: number;
  wire: {
    frame: string;
    acked: boolean;
    fields: [string, string][];
    bits: [number, number, number][];
  } | null;
  spi: {
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
