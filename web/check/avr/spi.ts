// The SPI as a master (Atmel 2545 section 19), in place of avr8js's AVRSPI, for one device.
//
// AVRSPI asks its device once, at the start of a byte; here the device latches its answer at the
// start and gets the byte at the end. AVRSPI clears SPIF only when SPDR is written; the chip does so
// at any access of SPDR after a read of SPSR with SPIF set (section 19.5.2).
// Not modelled: slave mode, the phase of the SCK divider.

import type { CPU } from "avr8js";
import { SPCR, SPDR, SPSR } from "./registers";

const SPIE = 0x80;
const SPE = 0x40;
const DORD = 0x20;
const MSTR = 0x10;
const SPIF = 0x80;
const WCOL = 0x40;
const SPI2X = 0x01;
const DIVISORS = [4, 16, 64, 128];

/** A device on the SPI. Times in cycles. */
export interface SpiDevice {
  beginByte(at: number): void;
  /** Returns the byte that the device has shifted out. */
  endByte(mosi: number, start: number, end: number, cyclesPerBit: number, mode: number): number;
}

export class Spi {
  private transfer: { mosi: number; start: number; end: number; cyclesPerBit: number } | null = null;
  private received = 0;
  private statusSeen = false;
  private readonly interrupt = {
    address: 0x22,
    flagRegister: SPSR,
    flagMask: SPIF,
    enableRegister: SPCR,
    enableMask: SPIE,
  };
  private readonly done = () => this.finish();

  constructor(
    private readonly cpu: CPU,
    private readonly device: () => SpiDevice | null,
  ) {
    const { data, writeHooks, readHooks } = cpu;
    writeHooks[SPDR] = (value) => this.write(value);
    readHooks[SPDR] = () => {
      this.clearFlags();
      return this.received;
    };
    readHooks[SPSR] = () => {
      this.statusSeen = (data[SPSR] & (SPIF | WCOL)) !== 0;
      return data[SPSR];
    };
    writeHooks[SPSR] = (value) => {
      data[SPSR] = (data[SPSR] & ~SPI2X) | (value & SPI2X);
      return true;
    };
    writeHooks[SPCR] = (value) => {
      data[SPCR] = value;
      cpu.updateInterruptEnable(this.interrupt, value);
      if (!(value & SPE)) {
        this.transfer = null;
        cpu.clearClockEvent(this.done);
      }
      return true;
    };
  }

  private write(value: number) {
    const { cpu } = this;
    const control = cpu.data[SPCR];
    if ((control & (SPE | MSTR)) !== (SPE | MSTR)) {
      return true;
    }
    if (this.transfer) {
      cpu.data[SPSR] |= WCOL;
      return true;
    }
    this.clearFlags();
    const start = cpu.cycles;
    const cyclesPerBit = DIVISORS[control & 3] / (cpu.data[SPSR] & SPI2X ? 2 : 1);
    const end = start + 8 * cyclesPerBit;
    this.transfer = { mosi: value, start, end, cyclesPerBit };
    cpu.addClockEvent(this.done, end - start);
    this.device()?.beginByte(start);
    return true;
  }

  private finish() {
    const { cpu, transfer } = this;
    if (!transfer) {
      return;
    }
    this.transfer = null;
    const control = cpu.data[SPCR];
    const order = (byte: number) => (control & DORD ? reversed(byte) : byte);
    const { mosi, start, end, cyclesPerBit } = transfer;
    const mode = (control >> 2) & 3;
    const miso = this.device()?.endByte(order(mosi), start, end, cyclesPerBit, mode) ?? 0xff;
    this.received = order(miso);
    cpu.setInterruptFlag(this.interrupt);
  }

  private clearFlags() {
    if (this.statusSeen) {
      this.statusSeen = false;
      this.cpu.clearInterrupt(this.interrupt);
      this.cpu.data[SPSR] &= ~WCOL;
    }
  }
}

function reversed(byte: number) {
  let result = 0;
  for (let bit = 0; bit < 8; bit++) {
    result = (result << 1) | ((byte >> bit) & 1);
  }
  return result;
}
