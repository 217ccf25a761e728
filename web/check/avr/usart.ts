// USART0 in asynchronous mode (Atmel 2545 section 20), in place of avr8js's AVRUSART.
//
// AVRUSART has one transmit buffer and sets UDRE0 at the end of a character; the chip moves the
// byte to its shift register and is ready for the next at once (section 20.6.1). It has no FIFO for
// received bytes and no data overrun (section 20.7). The other end sends back to back.
// Not modelled: synchronous modes, nine data bits, parity errors.

import type { CPU } from "avr8js";
import { UBRR0H, UBRR0L, UCSR0A, UCSR0B, UCSR0C, UDR0 } from "./registers";

const RXC = 0x80;
const TXC = 0x40;
const UDRE = 0x20;
const DOR = 0x08;
const U2X = 0x02;
const MPCM = 0x01;
const RXEN = 0x10;
const TXEN = 0x08;
/** "two level FIFO" (section 20.7.3). */
const FIFO = 2;

/** A character on TXD or RXD; `bits` is 0 if a reset cut off the last one. */
export interface Character {
  toChip: boolean;
  start: number;
  cyclesPerBit: number;
  /** The levels of the bits. Bit 0 is the start bit. */
  levels: number;
  bits: number;
}

export class Usart {
  private sending = false;
  private buffer: number | null = null;
  private arriving: number | null = null;
  private waiting: number | null = null;
  private received: number[] = [];
  private readonly rxc;
  private readonly udre;
  private readonly txc;
  private readonly sent = () => this.endSending();
  private readonly arrived = () => this.endReceiving();
  private sendingEnd = 0;
  private arrivingEnd = 0;

  /**
   * @param line bytes from outside that have not begun to arrive
   * @param trace called at the start of each character
   */
  constructor(
    private readonly cpu: CPU,
    private readonly line: number[],
    private readonly trace: (character: Character) => void,
  ) {
    const interrupt = (address: number, flagMask: number, enableMask: number, constant: boolean) => ({
      address,
      flagRegister: UCSR0A,
      flagMask,
      enableRegister: UCSR0B,
      enableMask,
      constant,
    });
    this.rxc = interrupt(0x24, RXC, 0x80, true);
    this.udre = interrupt(0x26, UDRE, 0x20, true);
    this.txc = interrupt(0x28, TXC, 0x40, false);
    const { data, writeHooks, readHooks } = cpu;
    data[UCSR0A] = UDRE;
    data[UCSR0B] = 0;
    data[UCSR0C] = 0x06;
    writeHooks[UCSR0A] = (value) => {
      data[UCSR0A] = (data[UCSR0A] & ~(U2X | MPCM)) | (value & (U2X | MPCM));
      if (value & TXC) {
        cpu.clearInterrupt(this.txc);
      }
      return true;
    };
    writeHooks[UCSR0B] = (value) => this.writeControl(value);
    writeHooks[UDR0] = (value) => this.write(value);
    readHooks[UDR0] = () => this.read();
  }

  /** True while a character is on TXD. */
  get isSending() {
    return this.sending;
  }

  /** Lets bytes that were added to the line arrive. */
  startReceiving(at = this.cpu.cycles) {
    const { data } = this.cpu;
    if (this.arriving !== null || !(data[UCSR0B] & RXEN)) {
      return;
    }
    const byte = this.line.shift();
    if (byte === undefined) {
      return;
    }
    // A new start bit, while the FIFO is full and a character waits in the shift register, is a
    // data overrun (section 20.11.2).
    if (this.waiting !== null) {
      this.waiting = null;
      data[UCSR0A] |= DOR;
    }
    this.arriving = byte;
    this.arrivingEnd = this.begin(byte, at, true);
    this.cpu.addClockEvent(this.arrived, this.arrivingEnd - this.cpu.cycles);
  }

  private writeControl(value: number) {
    const { cpu } = this;
    cpu.data[UCSR0B] = value;
    if (!(value & RXEN)) {
      this.arriving = null;
      this.waiting = null;
      this.received = [];
      cpu.clearClockEvent(this.arrived);
      cpu.clearInterrupt(this.rxc);
      cpu.data[UCSR0A] &= ~DOR;
    }
    for (const interrupt of [this.rxc, this.udre, this.txc]) {
      cpu.updateInterruptEnable(interrupt, value);
    }
    this.startReceiving();
    return true;
  }

  private write(value: number) {
    const { cpu } = this;
    if (cpu.data[UCSR0B] & TXEN) {
      if (!this.sending) {
        this.startSending(value, cpu.cycles);
      } else if (this.buffer === null) {
        this.buffer = value;
        cpu.clearInterrupt(this.udre);
      }
    }
    return true;
  }

  private read() {
    const { cpu } = this;
    const value = this.received.shift() ?? 0;
    cpu.data[UCSR0A] &= ~DOR;
    if (this.waiting !== null) {
      this.received.push(this.waiting);
      this.waiting = null;
    }
    if (this.received.length === 0) {
      cpu.clearInterrupt(this.rxc);
    }
    return value;
  }

  private startSending(value: number, at: number) {
    this.sending = true;
    this.sendingEnd = this.begin(value, at, false);
    this.cpu.addClockEvent(this.sent, this.sendingEnd - this.cpu.cycles);
  }

  private endSending() {
    const { cpu } = this;
    this.sending = false;
    if (this.buffer === null) {
      cpu.setInterruptFlag(this.txc);
    } else {
      const next = this.buffer;
      this.buffer = null;
      this.startSending(next, this.sendingEnd);
      cpu.setInterruptFlag(this.udre);
    }
  }

  private endReceiving() {
    const byte = this.arriving;
    this.arriving = null;
    if (byte !== null) {
      if (this.received.length < FIFO) {
        this.received.push(byte);
      } else {
        this.waiting = byte;
      }
      this.cpu.setInterruptFlag(this.rxc);
    }
    this.startReceiving(this.arrivingEnd);
  }

  /** Begins a character on a line. Returns the time of its end. */
  private begin(byte: number, start: number, toChip: boolean) {
    const { data } = this.cpu;
    const divisor = (((data[UBRR0H] & 0x0f) << 8) | data[UBRR0L]) + 1;
    const cyclesPerBit = divisor * (data[UCSR0A] & U2X ? 8 : 16);
    const format = data[UCSR0C];
    const dataBits = 5 + ((format >> 1) & 3);
    const value = byte & ((1 << dataBits) - 1);
    let levels = value << 1;
    let bits = 1 + dataBits;
    if (format & 0x20) {
      let parity = format & 0x10 ? 1 : 0;
      for (let rest = value; rest; rest >>= 1) {
        parity ^= rest & 1;
      }
      levels |= parity << bits++;
    }
    const stopBits = format & 0x08 ? 2 : 1;
    levels |= ((1 << stopBits) - 1) << bits;
    bits += stopBits;
    this.trace({ toChip, start, cyclesPerBit, levels, bits });
    return start + bits * cyclesPerBit;
  }
}
