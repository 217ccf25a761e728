// Links that restore what runs: the page's address with `#program=...`.

export interface Link {
  /** Name of a program of the page, or of the user's own file, which the link does not have. */
  program: string;
  pattern: string;
  /** The corner of the chips, as `sim --corner` takes it. */
  corner: string;
  /** The choices of board.ts for the user's own program. */
  wiring: string;
  /** As eeprom.ts encodes it: with it the saved parameters. */
  eeprom: string;
  /** Parameters that are set, but not saved. */
  parameters: [string, number][];
  faults: string[];
}

/** The part of an address from its `#` on. */
export function toHash({ parameters, faults, ...texts }: Link) {
  const pairs: [string, string][] = parameters.map(([name, value]) => ["set", `${name}=${value}`]);
  const all = [...Object.entries(texts), ...pairs, ...faults.map((name) => ["fault", name])];
  return `#${new URLSearchParams(all as [string, string][])}`;
}

/** Reads the part of an address from its `#` on; null if it is no link of this page. */
export function fromHash(hash: string): Link | null {
  const all = new URLSearchParams(hash.slice(1));
  const text = (name: string) => all.get(name) ?? "";
  const parameters = all.getAll("set").map((pair): [string, number] => {
    const [name, value] = pair.split("=");
    return [name, Number(value)];
  });
  const faults = all.getAll("fault");
  const [program, pattern, corner, wiring, eeprom] = ["program", "pattern", "corner", "wiring", "eeprom"].map(text);
  return program ? { program, pattern, corner, wiring, eeprom, parameters, faults } : null;
}
