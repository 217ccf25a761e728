// EEPROM (Atmel 2545 section 8.4), in place of avr8js's AVREEPROM.
//
// AVREEPROM changes the cell at the start of a write, and takes 3.6 ms for erase and write. The chip
// takes 3.4 ms (table 8-1). Here the cell changes at the end.

import type { CPU } from "avr8js";
import { EEARH, EEARL, EECR, EEDR } from "./registers";

const EERE = 0x01;
const EEPE = 0x02;
const EEMPE = 0x04;
const EERIE = 0x08;
const EEPM = 0x30;
/** Table 8-1, in cycles of 16 MHz. */
const ERASE_AND_WRITE = 54_400;
const HALF_OPERATION = 28_800;
/** Hardware clears EEMPE after four cycles (section 8.6.3). */
const MASTER_ENABLE = 4;

interface Programming {
  address: number;
  value: number;
  end: number;
}

/** The cells, and the operation in progress. They outlive a reset. */
export class EepromCells {
  programming: Programming | null = null;
  constructor(public bytes: Uint8Array) {}
}

export class Eeprom {
  private enabledUntil = 0;
  private readonly ready = {
    address: 0x2c,
    flagRegister: EECR,
    flagMask: EEPE,
    enableRegister: EECR,
    enableMask: EERIE,
    constant: true,
    inverseFlag: true,
  };
  private readonly done = () => this.finish();

  constructor(
    private readonly cpu: CPU,
    private readonly cells: EepromCells,
  ) {
    const { data, writeHooks, readHooks } = cpu;
    writeHooks[EECR] = (value) => this.writeControl(value);
    readHooks[EECR] = () => {
      const enabled = cpu.cycles < this.enabledUntil ? EEMPE : 0;
      return (data[EECR] & (EEPM | EERIE | EEPE)) | enabled;
    };
    for (const address of [EEARL, EEARH]) {
      writeHooks[address] = (value) => {
        if (!cells.programming) {
          data[address] = value;
        }
        return true;
      };
    }
    // A reset does not stop a write.
    if (cells.programming) {
      data[EECR] |= EEPE;
      cpu.addClockEvent(this.done, cells.programming.end - cpu.cycles);
    }
  }

  private writeControl(value: number) {
    const { cpu, cells } = this;
    const { data } = cpu;
    const busy = cells.programming !== null;
    const mode = busy ? data[EECR] & EEPM : value & EEPM;
    const enabled = cpu.cycles < this.enabledUntil;
    data[EECR] = mode | (value & EERIE) | (busy ? EEPE : 0);
    const address = ((data[EEARH] << 8) | data[EEARL]) % cells.bytes.length;
    if (value & EEPE && enabled) {
      this.enabledUntil = 0;
      if (!busy) {
        this.program(mode >> 4, address);
      }
    } else if (value & EEMPE) {
      this.enabledUntil = cpu.cycles + MASTER_ENABLE;
    }
    if (value & EERE && !busy) {
      data[EEDR] = cells.bytes[address];
      // The CPU is halted for four cycles (section 8.6.3).
      cpu.cycles += 4;
    }
    cpu.updateInterruptEnable(this.ready, value);
    return true;
  }

  private program(mode: number, address: number) {
    const { cpu, cells } = this;
    if (mode === 3) {
      return;
    }
    const byte = cpu.data[EEDR];
    const value = mode === 0 ? byte : mode === 1 ? 0xff : cells.bytes[address] & byte;
    const end = cpu.cycles + (mode === 0 ? ERASE_AND_WRITE : HALF_OPERATION);
    cells.programming = { address, value, end };
    cpu.data[EECR] |= EEPE;
    cpu.addClockEvent(this.done, end - cpu.cycles);
    // The CPU is halted for two cycles (section 8.6.3).
    cpu.cycles += 2;
  }

  private finish() {
    const { cpu, cells } = this;
    if (cells.programming) {
      cells.bytes[cells.programming.address] = cells.programming.value;
      cells.programming = null;
    }
    cpu.setInterruptFlag(this.ready);
  }
}
