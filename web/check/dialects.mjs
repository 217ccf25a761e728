// SLCAN adapters that answer otherwise than that of sim, for the tests of "Real bus". Each follows
// the public sources of a firmware, which are named; the bus behind it is that of `sim --slcan`.

import { Board } from "./fake-serial.mjs";

const [OK, ERROR] = ["\r", "\x07"];
const isFrame = (line) => /^[tTrR]/.test(line);
const digits = (value) => value.toString(16).toUpperCase().padStart(4, "0");

/** An adapter that answers the page's commands itself, and has sim's carry the frames. */
class Adapter extends Board {
  /** What the page has sent, a command each. */
  commands = [];
  unfinished = "";
  answers = "";
  rest = "";
  isOpen = false;
  listensOnly = false;

  async write(bytes) {
    const lines = (this.unfinished + bytes.toString("latin1")).split("\r");
    this.unfinished = lines.pop();
    for (const line of lines) {
      this.commands.push(line);
      this.answers += this.answer(line);
      if (isFrame(line) && this.isOpen && !this.listensOnly) {
        await super.write(Buffer.from(`${line}\r`));
      }
    }
    return true;
  }

  /** Opens or closes the channel of sim's adapter. */
  set(isOpen, listensOnly = false) {
    [this.isOpen, this.listensOnly] = [isOpen, listensOnly];
    void super.write(Buffer.from(isOpen ? `C\rS8\r${listensOnly ? "L" : "O"}\r` : "C\r"));
  }

  read() {
    const bytes = super.read();
    if (bytes === null) {
      return null;
    }
    const lines = (this.rest + bytes.toString("latin1").replaceAll(ERROR, "")).split("\r");
    this.rest = lines.pop();
    // The answers of sim's adapter are not for the page.
    const frames = lines.filter((line) => isFrame(line) && this.isOpen).map((line) => this.told(line));
    const all = this.answers + frames.join("");
    this.answers = "";
    return Buffer.from(all, "latin1");
  }

  /** A received frame as the adapter tells it. */
  told(frame) {
    return `${frame}\r`;
  }
}

/**
 * A flight controller with ArduPilot: `AP_SLCANIface.cpp` of github.com/ArduPilot/ardupilot. It
 * accepts S, O, L, C, M, m, U and Z without an effect, rejects an empty line, answers a frame by Z
 * or z, and puts a time stamp of 16 bits, in milliseconds, behind each frame.
 */
export class ArduPilot extends Adapter {
  answer(line) {
    if (!this.isOpen) {
      this.set(true);
    }
    const letter = line[0] ?? "";
    if (isFrame(line)) {
      return `${letter === "t" || letter === "r" ? "z" : "Z"}\r`;
    }
    return letter === "F" ? "F00\r" : "SOLCMmUZ".includes(letter) && letter !== "" ? OK : ERROR;
  }

  told(frame) {
    return `${frame}${digits(Math.round(performance.now()) & 0xffff)}\r`;
  }
}

/**
 * A CANable 2.0 with its maker's firmware: `src/slcan.c` of github.com/normaldotcom/canable2-fw. It
 * answers no command, and does not know L.
 */
export class Canable extends Adapter {
  answer(line) {
    if (line === "O" || line === "C") {
      this.set(line === "O");
    }
    return "";
  }
}

/**
 * A CANable 2.0 with the firmware of github.com/Nakakiyo092/canable2-fw (`src/slcan.c`,
 * `src/can.c`), which follows Lawicel's manual: an empty line is accepted, C is an error while the
 * channel is closed, S, O and L are while it is open, frames are unless it is open to send. Its time
 * stamps were left on (Z1): milliseconds of the minute.
 */
export class Lawicel extends Adapter {
  answer(line) {
    const can = (isPossible, act = () => {}) => {
      if (isPossible) {
        act();
      }
      return isPossible ? OK : ERROR;
    };
    if (isFrame(line)) {
      const isSent = this.isOpen && !this.listensOnly;
      return isSent ? `${/^[TR]/.test(line) ? "Z" : "z"}\r` : ERROR;
    }
    switch (line[0]) {
      case undefined:
        return OK;
      case "C":
        return can(this.isOpen, () => this.set(false));
      case "S":
        return can(!this.isOpen && /^S[0-8]$/.test(line));
      case "O":
      case "L":
        return can(!this.isOpen, () => this.set(true, line === "L"));
      case "F":
        return this.isOpen ? "F00\r" : ERROR;
      default:
        return ERROR;
    }
  }

  told(frame) {
    return `${frame}${digits(Math.round(performance.now()) % 60_000)}\r`;
  }
}

/** The same without L, as adapters by Lawicel's first manual, which has no such command. */
export class SendsOnly extends Lawicel {
  answer(line) {
    return line === "L" ? ERROR : super.answer(line);
  }
}
