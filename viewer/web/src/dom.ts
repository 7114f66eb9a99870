type Child = Node | string | null;

/** Creates an element with attributes and children. Text is never interpreted as markup. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  for (const child of children) if (child !== null) element.append(child);
  return element;
}

export function button(text: string, classes: string, action: () => void): HTMLButtonElement {
  const element = el("button", { type: "button", class: `tv-button ${classes}` }, text);
  element.addEventListener("click", action);
  return element;
}

/** Sets the text only if it has changed, to avoid a new layout. */
export function say(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Formats a number with a true minus sign. */
export function number(value: number, digits: number): string {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/** Opens a socket to the server of this page. */
export function openSocket(): WebSocket {
  const url = new URL("live", location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  return new WebSocket(url);
}
