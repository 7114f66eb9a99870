// The input of the page: the JSON of `tesaki-viewer` (Rust) and of `tesaki view`.

/** Position [m] and unit quaternion x, y, z, w. */
export type Pose = [number, number, number, number, number, number, number];
export type Vec = [number, number, number];

export interface SceneJoint {
  name: string;
  parent: number | null;
  origin: Pose;
  axis: Vec;
  limits: [number, number];
  torque: number;
  /** For a mimic joint: the joint that it follows, multiplier, offset. */
  follows: [number, number, number] | null;
}

export interface Tip {
  name: string;
  joint: number;
  pose: Pose;
  radius: number;
  sensor: boolean;
}

export type SolidShape = { box: Vec } | { cylinder: [number, number] } | { sphere: number };

export interface Scene {
  name: string;
  gravity: Vec;
  joints: SceneJoint[];
  driven: number;
  tips: Tip[];
  solids: { joint: number | null; pose: Pose; shape: SolidShape }[];
}

export type ObjectShape =
  | { box: Vec }
  | { cylinder: [number, number] }
  | { wedge: [number, number, number, number] };

export interface Contact {
  tip: number;
  point: Vec;
  force: Vec;
  normal: Vec;
  friction: number;
}

export interface Sample {
  q: number[];
  v: number[];
  u: number[];
  r?: number[];
  f?: [string, Pose][];
  c?: Contact[];
}

export interface Replay {
  scene: Scene;
  period: number;
  /** Those with the latest `since` are shown, in their frame or, without one, fixed. */
  objects: { since: number; frame: string | null; shape: ObjectShape; pose: Pose }[];
  notes: { time: number; text: string }[];
  samples: Sample[];
}

/** The first message to the page of a run. */
export interface Run {
  kind: "run";
  /** Identifies the run. */
  id: string;
  period: number;
  about: { title: string; scenario: string; about: string; controller: string; seed: number; scene: Scene };
}

/** What was computed since the last message. */
export interface Part {
  kind: "part";
  samples: Sample[];
  objects: Replay["objects"];
  notes: Replay["notes"];
  /** With the last samples: how the run ended. */
  end: { verdict: Verdict } | { error: string } | null;
}

export interface Verdict {
  pass: boolean;
  text: string;
  rows: { label: string; measured: string; limit: string; pass: boolean | null; note: string | null }[];
}

/** The state of a board after a tick. */
export interface State {
  kind: "state";
  /** Number of this message, to be sent back. */
  n: number;
  tick: number;
  mode: "disabled" | "enabled" | "fault";
  /** The task that runs. */
  task: string | null;
  /** For each joint: angle, velocity, reference, torque. */
  joints: [number, number, number, number][];
  /** For each tip: position, force on it, and whether its sensor was tared. */
  tips: { position: Vec; force: Vec; tared: boolean }[];
  report: TaskReport | null;
  /** Maximum time from the tick to the server; half the time from server to page and back [ms]. */
  delay: [number, number];
}

export interface TaskReport {
  task: string;
  /** What the task does, in words. */
  phase: string | null;
  /** A frame that it controls, and its set-point. */
  frame?: Pose;
  target?: Pose;
  /** Desired forces of a grasp on the object. */
  forces?: Vec[];
  /** Directions of the contacts, into the object, and the friction there. */
  normals?: Vec[];
  friction?: number;
  /** Whether the arm is nearly singular, if so. */
  nearly_singular?: boolean;
  /** Further numbers with their names and units. */
  values: [string, number, string][];
}

export interface Fault {
  text: string;
  title: string;
  likely: string;
  remedy: string;
}

export interface Status {
  kind: "status";
  port: string;
  firmware: string;
  supply: number;
  homed: boolean[];
  /** Which client commands the board. */
  commander: "nobody" | "you" | "page" | "program";
  /** Parts that fall without power. */
  falls: string | null;
  /** Files with which the page may enable a task. */
  plans: { task: string; name: string }[];
  faults: Fault[];
  /** Number of faults since power-on, with those that are shown; null while there is nothing to clear. */
  total: number | null;
  /** Why there is nothing to show, if so. */
  trouble: string | null;
}

export type FromServer =
  | { kind: "scene"; scene: Scene | null }
  | State
  | Status
  | { kind: "answer"; ok: boolean; text: string };
