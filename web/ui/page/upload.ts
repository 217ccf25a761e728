// Uploads to a real board: the port of ports.ts and the protocol of web/src/stk500.rs.

import { Upload } from "pkg/web.js";
import boards from "boards.json";
import type { Port } from "./ports";

/** JSON of `Upload.state`. */
export interface State {
  phase: "connecting" | "writing" | "comparing" | "ended";
  done: number;
  all: number;
  failure: string | null;
  /** True if no bootloader has answered. */
  is_silent: boolean;
  is_cancelled: boolean;
  /** True if the board has the new program, which was read back. */
  is_new: boolean;
  /** What the flash has, in words. */
  flash: string;
  chip: string | null;
}

/** Resets of the board until it counts as silent. */
const ROUNDS = 2;
/** Longest wait of one read, so that "Cancel" is soon noticed. */
const READ_MS = 200;

/** An upload that can be cancelled. */
export class Uploader {
  private session: Upload | null = null;
  private isCancelled = false;
  /** The last state. */
  state: State | null = null;

  /** `changed` gets the state after each step. */
  constructor(
    private readonly port: Port,
    private readonly changed: (state: State) => void,
  ) {}

  cancel() {
    this.isCancelled = true;
    this.session?.cancel(performance.now());
  }

  /**
   * Uploads a program to a board with a chip. The port is closed afterwards. Throws a PortError;
   * `owner` is the name of the part of the page.
   */
  async upload(program: Uint8Array, chip: string, baud: number, owner: string): Promise<State> {
    let state = await this.at(baud, owner, ROUNDS, (now) => new Upload(chip, program, now));
    if (state.is_silent && !this.isCancelled) {
      const found = await this.search(baud, owner);
      state = found ? { ...state, failure: found } : state;
    }
    return state;
  }

  /** Sessions at a baud rate until one finds a bootloader. */
  private async at(baud: number, owner: string, rounds: number, begin: (now: number) => Upload) {
    await this.port.open(baud, owner);
    try {
      for (let round = 1; ; round++) {
        await this.port.reset();
        const state = await this.run(begin(performance.now()));
        if (!state.is_silent || round === rounds || this.isCancelled) {
          return state;
        }
      }
    } finally {
      await this.port.close();
    }
  }

  private async run(session: Upload): Promise<State> {
    this.session = session;
    try {
      for (;;) {
        if (this.isCancelled) {
          session.cancel(performance.now());
        }
        const output = session.take_output();
        if (output.length > 0) {
          await this.port.write(output);
        }
        const state: State = JSON.parse(session.state());
        this.state = state;
        this.changed(state);
        if (state.phase === "ended") {
          return state;
        }
        const wait = Math.min(session.wait_ms(performance.now()), READ_MS);
        session.receive(await this.port.read(wait), performance.now());
      }
    } finally {
      this.session = null;
      session.free();
    }
  }

  /** Looks for a bootloader at the other baud rates. Returns the boards that it can be, in words. */
  private async search(tried: number, owner: string): Promise<string | null> {
    const rates = [...new Set(boards.boards.map(({ baud }) => baud))];
    for (const baud of rates.filter((rate) => rate !== tried)) {
      if (this.isCancelled) {
        return null;
      }
      const { chip } = await this.at(baud, owner, 1, (now) => Upload.identify(now));
      const titles = boards.boards.filter((board) => board.chip === chip && board.baud === baud);
      if (chip !== null) {
        const names = titles.map(({ title }) => title).join(", or ") || `board with an ${boards.chips[chip].title}`;
        return `The board answers at ${baud} baud: it is another one than the one that is chosen. Choose ${names}. Nothing was written.`;
      }
    }
    return null;
  }
}
