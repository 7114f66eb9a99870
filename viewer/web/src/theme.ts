// Colours of scene and charts. Lines are those of the reports' figures (Okabe and Ito, darkened).

export interface Theme {
  dark: boolean;
  ground: string;
  ink: string;
  muted: string;
  grid: string;
  link: string;
  base: string;
  tip: string;
  object: string;
  accent: string;
  force: string;
}

const LIGHT: Theme = {
  dark: false,
  ground: "#f6f8fa",
  ink: "#1b1f24",
  muted: "#57606a",
  grid: "#dde2e7",
  link: "#c3cad2",
  base: "#8b959f",
  tip: "#4a525b",
  object: "#e6d9bf",
  accent: "#0072b2",
  force: "#d55e00",
};

const DARK: Theme = {
  dark: true,
  ground: "#1c2229",
  ink: "#e6e9ed",
  muted: "#a3adb8",
  grid: "#333b45",
  link: "#8a95a1",
  base: "#59636e",
  tip: "#c6cdd5",
  object: "#a8977a",
  accent: "#4fa8dc",
  force: "#ee8b3c",
};

// Nine, as hand3 has joints.
export const LINES = ["#0072b2", "#d55e00", "#009e73", "#c0659a", "#b07d00", "#3a93c8", "#7a7f87", "#8e6bbf", "#7a3b1d"];
const LINES_DARK = ["#4fa8dc", "#ee8b3c", "#2fc296", "#d88bb7", "#d3a02a", "#7cc0ea", "#9aa1aa", "#b096dc", "#f0d5bd"];

const query = matchMedia("(prefers-color-scheme: dark)");

export const theme = (): Theme => (query.matches ? DARK : LIGHT);
export const light = LIGHT;
export const lineColour = (index: number): string => (query.matches ? LINES_DARK : LINES)[index % LINES.length];
export const onThemeChange = (action: () => void, signal?: AbortSignal): void => query.addEventListener("change", action, { signal });
