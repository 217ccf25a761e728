// The watchdog (Atmel 2545 section 11.8), in place of avr8js's AVRWatchdog.
//
// AVRWatchdog counts exactly 128 kHz, and its reset keeps the registers of the peripherals. Here the
// board gives the length of each time-out, and a reset is that of the chip.

import type { CPU } from "avr8js";
import { MCUSR, WDRF, WDTCSR } from "./registers";

const WDIF = 0x80;
const WDIE = 0x40;
const WDCE = 0x10;
const WDE = 0x08;
const WDP = 0x27;
/** Cycles after which WDCE is cleared (section 11.9.2). */
const CHANGE_ENABLE = 4;

export class Watchdog {
  private changeUntil = 0;
  private next: number;
  private end = 0;
  private readonly interrupt = {
    address: 0x0c,
    flagRegister: WDTCSR,
    flagMask: WDIF,
    enableRegister: WDTCSR,
    enableMask: WDIE,
  };
  private readonly expired = () => this.timeOut();

  /**
   * @param control WDTCSR before the reset: a reset by the watchdog leaves it running
   * @param length length of the next time-out in cycles, for a value of WDTCSR
   */
  constructor(
    private readonly cpu: CPU,
    control: number,
    private readonly length: (control: number) => number,
    private readonly reset: () => void,
  ) {
    const { data, writeHooks } = cpu;
    // WDRF in MCUSR keeps WDE set (section 11.9.2).
    data[WDTCSR] = data[MCUSR] & WDRF ? WDE | (control & WDP) : 0;
    this.next = length(data[WDTCSR]);
    cpu.onWatchdogReset = () => this.restart();
    writeHooks[WDTCSR] = (value) => this.write(value);
    if (data[WDTCSR] & WDE) {
      this.restart();
    }
  }

  private write(value: number) {
    const { cpu } = this;
    const before = cpu.data[WDTCSR];
    const mayChange = cpu.cycles < this.changeUntil;
    let after = (before & (WDE | WDP)) | (value & WDIE);
    if (mayChange) {
      after = (value & (WDE | WDP | WDIE)) | (cpu.data[MCUSR] & WDRF ? WDE : 0);
    } else if (value & WDE) {
      after |= WDE;
    }
    if ((value & (WDCE | WDE)) === (WDCE | WDE)) {
      this.changeUntil = cpu.cycles + CHANGE_ENABLE;
    } else {
      this.changeUntil = 0;
    }
    // A one clears WDIF.
    after |= before & ~value & WDIF;
    cpu.data[WDTCSR] = after;
    if (before & value & WDIF) {
      cpu.clearInterrupt(this.interrupt);
    }
    cpu.updateInterruptEnable(this.interrupt, after);
    this.next = this.length(after);
    const wasOn = (before & (WDE | WDIE)) !== 0;
    if ((after & (WDE | WDIE)) === 0) {
      cpu.clearClockEvent(this.expired);
    } else if (!wasOn || (before ^ after) & WDP) {
      this.restart();
    }
    return true;
  }

  private restart() {
    const { cpu } = this;
    cpu.clearClockEvent(this.expired);
    if (cpu.data[WDTCSR] & (WDE | WDIE)) {
      this.end = cpu.cycles + this.next;
      cpu.addClockEvent(this.expired, this.next);
    }
  }

  private timeOut() {
    const { cpu } = this;
    const control = cpu.data[WDTCSR];
    if (control & WDIE) {
      this.next = this.length(control);
      cpu.setInterruptFlag(this.interrupt);
      if (control & WDE) {
        cpu.data[WDTCSR] &= ~WDIE;
      }
      this.end += this.next;
      cpu.addClockEvent(this.expired, this.end - cpu.cycles);
    } else {
      this.reset();
    }
  }
}
