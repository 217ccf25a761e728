// The EEPROM of each program, which the browser keeps over a reload, as a board keeps it without
// power. A browser that keeps nothing, or is full, has each program begin anew.

const ERASED = 0xff;
const key = (program: string) => `EEPROM of ${program}`;
/** That of a link, whose name is the address from its `#` on, ends with the tab. */
const storage = (program: string) => (program.startsWith("#") ? sessionStorage : localStorage);

/** The bytes as text, without those at the end that are erased. */
export function encode(bytes: Uint8Array) {
  const used = bytes.slice(0, bytes.findLastIndex((byte) => byte !== ERASED) + 1);
  return btoa(String.fromCharCode(...used));
}

/** The bytes that the program left, or `fresh` if there are none or too many. */
export function kept(program: string, fresh: Uint8Array) {
  try {
    const text = storage(program).getItem(key(program));
    if (text === null) {
      return fresh;
    }
    const used = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const bytes = new Uint8Array(fresh.length).fill(ERASED);
    bytes.set(used);
    return bytes;
  } catch {
    return fresh;
  }
}

/** True if the program left bytes. */
export function isKept(program: string) {
  try {
    return storage(program).getItem(key(program)) !== null;
  } catch {
    return false;
  }
}

/** Keeps bytes that are encoded. */
export function keep(program: string, text: string) {
  try {
    if (storage(program).getItem(key(program)) !== text) {
      storage(program).setItem(key(program), text);
    }
  } catch {
    // The page works without.
  }
}

/** The next start has the EEPROM of the file. */
export function forget(program: string) {
  try {
    storage(program).removeItem(key(program));
  } catch {
    // Nothing was kept.
  }
}
