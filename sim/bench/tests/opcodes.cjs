// Executes each instruction of a trace of simavr on avr8js, from the same state, and prints what
// differs:
//
//   node opcodes.cjs AVR8JS FLASH TRACE
//
// A line of TRACE is the state before an instruction: R0 to R31, SREG, SP, PC (in bytes), cycles.

const fs = require("node:fs");
const [avr8js, flash, trace] = process.argv.slice(2);
const { CPU, avrInstruction } = require(avr8js);

const SP = 93;
const SREG = 95;
const H = 0x20;
const S = 0x10;
const V = 0x08;
const Z = 0x02;

/** H after the instruction by the manual of the instruction set; undefined if it computes none. */
function halfCarry(opcode, { registers, sreg }) {
  const carry = sreg & 1;
  const d = registers[(opcode >> 4) & 31] & 15;
  const r = registers[(opcode & 15) | ((opcode >> 5) & 16)] & 15;
  const high = registers[16 + ((opcode >> 4) & 15)] & 15;
  switch (opcode & 0xfc00) {
    case 0x0c00: // ADD
      return d + r > 15;
    case 0x1c00: // ADC
      return d + r + carry > 15;
    case 0x1400: // CP
    case 0x1800: // SUB
      return d < r;
    case 0x0400: // CPC
    case 0x0800: // SBC
      return d < r + carry;
  }
  switch (opcode & 0xf000) {
    case 0x3000: // CPI
    case 0x5000: // SUBI
      return high < (opcode & 15);
    case 0x4000: // SBCI
      return high < (opcode & 15) + carry;
  }
  if ((opcode & 0xfe0f) === 0x9401) {
    return d !== 0; // NEG
  }
  // ADIW and SBIW do not change H.
  return (opcode & 0xfe00) === 0x9600 ? (sreg & H) !== 0 : undefined;
}

/** True for CPC, SBC and SBCI of 0 - 255 - 1, whose result is 0. */
function borrowsAll(opcode, { registers, sreg }) {
  const isImmediate = (opcode & 0xf000) === 0x4000;
  if (!isImmediate && (opcode & 0xfc00) !== 0x0400 && (opcode & 0xfc00) !== 0x0800) {
    return false;
  }
  const d = registers[isImmediate ? 16 + ((opcode >> 4) & 15) : (opcode >> 4) & 31];
  const immediate = ((opcode >> 4) & 0xf0) | (opcode & 15);
  const r = isImmediate ? immediate : registers[(opcode & 15) | ((opcode >> 5) & 16)];
  return d === 0 && r === 255 && (sreg & 1) === 1;
}

/**
 * Where avr8js is wrong and simavr is right, by the manual (Atmel 0856). Each has a name, the
 * bits of SREG in which avr8js may differ, and the cycles that it lacks.
 */
function known(opcode, before, after) {
  if ((opcode & 0xff00) === 0x9800) {
    return { name: "cycles of CBI", flags: 0, cycles: 1 };
  }
  if ((opcode & 0xff88) === 0x0388) {
    const isZero = after.registers[0] === 0 && after.registers[1] === 0;
    return { name: "Z of FMULSU", flags: isZero === ((after.sreg & Z) !== 0) ? Z : 0, cycles: 0 };
  }
  const d = before.registers[(opcode >> 4) & 31];
  if ((opcode & 0xfe0f) === 0x9401 && d === 0x80) {
    // > V: Set if there is a two's complement overflow from the implied subtraction from zero
    const isRight = (after.sreg & (V | S)) === V;
    return { name: "V and S of NEG", flags: isRight ? V | S | H : 0, cycles: 0 };
  }
  const carry = halfCarry(opcode, before);
  const isRight = carry !== undefined && carry === ((after.sreg & H) !== 0);
  // > Z: Previous value remains unchanged when the result is zero
  const isWhole = borrowsAll(opcode, before) && ((before.sreg ^ after.sreg) & Z) === 0;
  return {
    name: isWhole ? "Z of CPC, SBC or SBCI" : "H",
    flags: (isRight ? H : 0) | (isWhole ? Z : 0),
    cycles: 0,
  };
}

const bytes = fs.readFileSync(flash);
const words = new Uint16Array(0x4000).fill(0xffff);
for (let at = 0; at < bytes.length; at += 2) {
  words[at / 2] = bytes.readUInt16LE(at);
}
const cpu = new CPU(words, 0x800);

const parse = (line) => {
  const [registers, sreg, sp, pc, cycles] = line.split(" ");
  return {
    registers: Buffer.from(registers, "hex"),
    sreg: parseInt(sreg, 16),
    sp: parseInt(sp, 16),
    pc: parseInt(pc, 16),
    cycles: Number(cycles),
  };
};

const states = fs.readFileSync(trace, "utf8").trimEnd().split("\n").map(parse);
const opcodes = new Set();
const counts = {};
for (let index = 0; index + 1 < states.length; index += 1) {
  const before = states[index];
  const after = states[index + 1];
  cpu.data.set(before.registers);
  cpu.data[SREG] = before.sreg;
  cpu.dataView.setUint16(SP, before.sp, true);
  cpu.pc = before.pc / 2;
  const start = cpu.cycles;
  const opcode = words[cpu.pc];
  opcodes.add(opcode);
  avrInstruction(cpu);
  const exempt = known(opcode, before, after);
  const cycles = cpu.cycles - start;
  const lacks = after.cycles - before.cycles - cycles;
  const flags = cpu.data[SREG] ^ after.sreg;
  if (lacks !== 0 || flags !== 0) {
    counts[exempt.name] = (counts[exempt.name] ?? 0) + 1;
  }
  const compared = [
    ...[...after.registers].map((value, register) => [`r${register}`, value, cpu.data[register]]),
    ["SREG", after.sreg, (flags & ~exempt.flags) === 0 ? after.sreg : cpu.data[SREG]],
    ["SP", after.sp, cpu.dataView.getUint16(SP, true)],
    ["PC", after.pc, cpu.pc * 2],
    ["cycles", after.cycles - before.cycles, lacks === exempt.cycles ? cycles + lacks : cycles],
  ];
  // simavr's H is compared with the manual's even where both agree.
  const carry = halfCarry(opcode, before);
  compared.push(["H", Number((after.sreg & H) !== 0), Number(carry ?? (after.sreg & H) !== 0)]);
  for (const [what, simavr, other] of compared) {
    if (simavr !== other) {
      const where = `opcode ${opcode.toString(16).padStart(4, "0")} at ${before.pc.toString(16)}`;
      const from = `SREG ${before.sreg.toString(16)}`;
      console.log(`${where}, ${from} before: ${what} simavr ${simavr}, avr8js ${other}`);
    }
  }
}
const list = Object.entries(counts).map(([name, count]) => `${count} times ${name}`);
console.error(
  `${states.length - 1} instructions, ${opcodes.size} opcodes; avr8js wrong ${list.join(", ")}`,
);
