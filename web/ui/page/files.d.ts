// Files that esbuild puts into the page.

declare module "*.elf" {
  const bytes: Uint8Array;
  export default bytes;
}
declare module "*.hex" {
  const bytes: Uint8Array;
  export default bytes;
}
declare module "*.wasm" {
  const bytes: Uint8Array;
  export default bytes;
}
/** By name, from docs/parameters.md. */
declare module "parameters.json" {
  const documented: Record<string, { unit: string; meaning: string } | undefined>;
  export default documented;
}
declare module "*.css";
/** Boards, and the files for them, from scripts/web-files. */
declare module "boards.json" {
  const boards: {
    boards: { name: string; title: string; chip: string; baud: number }[];
    shields: { name: string; title: string; bit_rate: number; drawing: string; hub: string }[];
    chips: Record<string, { title: string; preset: string }>;
    /** Name and meaning, by chip. */
    presets: Record<string, [string, string][]>;
    /** Name of the program in the directory files, by "board shield preset". */
    files: Record<string, string>;
    /** Name of the bootloader there, by "board shield". */
    loaders: Record<string, string>;
  };
  export default boards;
}
