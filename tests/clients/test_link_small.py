"""What `scripts/link-small` makes of small programs of assembly: what it leaves out, and what it must not touch."""

import re
import subprocess
import sys

import pytest

from conftest import ROOT

# PINC and PORTC, for values that the linker cannot know, and for results that somebody wants.
IN, OUT = "0x06", "0x08"

# `main` calls `f` for ever. Y is set to the window, which is how a program asks for being made smaller.
START = """
    .section .init3,"ax",@progbits
    ldi r28, lo8(__y_window)
    ldi r29, hi8(__y_window)
"""
MAIN = """
    .section .text.main,"ax",@progbits
    .global main
    .type main,@function
main:
1:  call f
    rjmp 1b
"""


@pytest.fixture
def linked(tmp_path):
    """Links functions, given by name and code, with a `main`; a function that gives the instructions of one in the program."""

    def link(main=MAIN, also="", quick=None, **functions):
        source = START + main + also
        for name, code in functions.items():
            source += f'\n    .section .text.{name},"ax",@progbits\n    .type {name},@function\n{name}:\n{code}\n'
        (tmp_path / "program.s").write_text(source)
        assembler = ["avr-gcc", "-mmcu=atmega168", "-mrelax", "-Wa,-mlink-relax", "-c", tmp_path / "program.s", "-o", tmp_path / "program.o"]
        subprocess.run(assembler, check=True)
        linker = [ROOT / "scripts" / "link-small", "-mmcu=atmega168", "-Wl,--gc-sections", tmp_path / "program.o", "-o", tmp_path / "program.elf"]
        if quick is not None:
            (tmp_path / "quick.txt").write_text(quick)
            linker.append(f"--quick={tmp_path / 'quick.txt'}")
        subprocess.run(linker, check=True)
        listing = subprocess.run(["avr-objdump", "-d", "--no-show-raw-insn", tmp_path / "program.elf"], check=True, capture_output=True, text=True)

        def instructions(name):
            found = []
            _, _, rest = listing.stdout.partition(f"<{name}>:\n")
            for line in rest.partition("\n\n")[0].splitlines():
                text = line.partition(":")[2].partition(";")[0].split()
                found.append(" ".join(text))
            return found

        return instructions

    return link


def addresses(tmp_path):
    listing = subprocess.run(["avr-nm", tmp_path / "program.elf"], check=True, capture_output=True, text=True).stdout
    return {name: int(value, 16) for value, _, name in (line.split() for line in listing.splitlines()) if value != "w"}


def test_variables_that_only_y_reaches_stay_where_y_reaches_them(linked, tmp_path):
    """The linker leaves out a variable that nothing refers to, and those behind it would move."""
    variables = "".join(
        f'    .section .bss.{name},"aw",@nobits\n    .type {name},@object\n    .size {name}, 1\n{name}: .zero 1\n' for name in ("first", "second")
    )
    program = linked(also=variables, f="    lds r24, first\n    sts second, r24\n    ret\n")
    found = addresses(tmp_path)
    reached = [int(re.search(r"Y\+?(\d*)", one)[1] or 0) + found["__y_window"] for one in program("f")[:2]]
    assert reached == [found["first"], found["second"]]


def without_jumps(instructions):
    return [one for one in instructions if not re.match(r"(rjmp|jmp|br\w\w) ", one)]


def sink(*registers):
    return "".join(f"    out {OUT}, {register}\n" for register in registers)


SAVING = f"""
    push r16
    in   r16, {IN}
    inc  r16
    out  {OUT}, r16
    pop  r16
    ret
"""


def test_a_register_that_no_caller_uses_is_not_saved(linked):
    program = linked(f=SAVING)
    assert program("f") == [f"in r16, {IN}", "inc r16", f"out {OUT}, r16", "ret"]


def test_a_register_that_a_caller_uses_after_the_call_stays_saved(linked):
    caller = f"    in r16, {IN}\n    call g\n    out {OUT}, r16\n    ret\n"
    assert "push r16" in linked(f=caller, g=SAVING)("g")


def test_a_register_that_a_caller_of_the_caller_uses_stays_saved(linked):
    outer = f"    in r16, {IN}\n    call g\n    out {OUT}, r16\n    ret\n"
    between = "    wdr\n    call h\n    wdr\n    ret\n"
    program = linked(f=outer, g=between, h=SAVING)
    assert "push r16" in program("h") and "pop r16" in program("h")


def test_a_register_that_is_used_after_a_tail_call_stays_saved(linked):
    outer = f"    in r16, {IN}\n    call g\n    out {OUT}, r16\n    ret\n"
    assert "push r16" in linked(f=outer, g="    wdr\n    rjmp h\n", h=SAVING)("h")


def test_what_is_saved_by_the_function_between_stays_what_it_was_for_its_caller(linked):
    """`g` calls, so what it has saved must come through the call."""
    outer = f"    in r16, {IN}\n    call g\n    out {OUT}, r16\n    ret\n"
    saving = f"    push r16\n    in r16, {IN}\n    call h\n    out {OUT}, r16\n    pop r16\n    ret\n"
    program = linked(f=outer, g=saving, h="    wdr\n    ret\n")
    assert "push r16" in program("g")
    assert program("f")[0] == f"in r16, {IN}", "what is saved is what is read before the call"


def test_a_function_that_others_can_reach_saves_what_it_did(linked):
    assert "push r16" in linked(also="    .global f\n", f=SAVING)("f")
    table = "    .section .rodata\n    .word pm(f)\n"
    assert "push r16" in linked(also=table, f=SAVING)("f")


def test_an_interrupt_handler_saves_all_that_it_changes(linked):
    handler = f"    push r24\n    in r24, 0x3F\n    push r24\n    in r24, {IN}\n    inc r24\n    out {OUT}, r24\n    pop r24\n    out 0x3F, r24\n    pop r24\n    reti\n"
    before = [" ".join(line.split()).replace("0x3F", "0x3f") for line in handler.splitlines()]
    assert linked(also="    .global __vector_14\n", f="    wdr\n    ret\n", __vector_14=handler)("__vector_14") == before


def test_a_push_whose_value_goes_to_another_register_stays(linked):
    moving = f"    in r16, {IN}\n    push r16\n    call g\n    pop r17\n    out {OUT}, r17\n    ret\n"
    program = linked(f=moving, g="    wdr\n    ret\n")("f")
    assert "push r16" in program and "pop r17" in program


def test_a_function_that_reads_the_stack_pointer_is_left_alone(linked):
    code = f"    push r16\n    in r30, 0x3D\n    in r31, 0x3E\n    ldd r24, Z+1\n    out {OUT}, r24\n    pop r16\n    ret\n"
    assert "push r16" in linked(f=code)("f")


def test_a_result_that_nobody_reads_is_not_worked_out(linked):
    code = f"    in r24, {IN}\n    ldi r25, 5\n    add r25, r24\n    out {OUT}, r24\n    ret\n"
    assert linked(f=code)("f") == [f"in r24, {IN}", f"out {OUT}, r24", "ret"]


def test_a_result_that_a_caller_reads_is_worked_out(linked):
    caller = f"    call g\n{sink('r25')}    ret\n"
    assert "ldi r25, 0x05" in linked(f=caller, g="    ldi r25, 5\n    ret\n")("g")


def test_a_result_that_is_passed_on_is_worked_out(linked):
    """`h` copies its argument to what it returns."""
    caller = f"    ldi r22, 5\n    call h\n{sink('r24')}    ret\n"
    assert "ldi r22, 0x05" in linked(f=caller, h="    wdr\n    mov r24, r22\n    wdr\n    ret\n")("f")


def test_flags_that_are_read_are_worked_out(linked):
    """The sum itself is not read, its carry is."""
    code = f"    in r24, {IN}\n    in r25, {IN}\n    add r24, r25\n    brcs 1f\n    out {OUT}, r25\n1:  ret\n"
    assert "add r24, r25" in linked(f=code)("f")


def test_ports_are_read_though_nobody_wants_the_value(linked):
    code = f"    in r24, {IN}\n    lds r25, 0x60\n    ret\n"
    assert linked(f=code)("f") == [f"in r24, {IN}", "lds r25, 0x0060", "ret"]


def test_a_copy_of_what_a_register_holds_already_goes(linked):
    code = f"    in r26, {IN}\n    in r27, {IN}\n    movw r30, r26\n    ldd r24, Z+1\n    movw r30, r26\n    ldd r25, Z+2\n{sink('r24', 'r25')}    ret\n"
    assert without_jumps(linked(f=code)("f")).count("movw r30, r26") <= 1


def test_a_copy_to_itself_goes(linked):
    code = f"    in r24, {IN}\n    mov r24, r24\n    movw r24, r24\n    ret\n"
    assert linked(f=code)("f") == [f"in r24, {IN}", "ret"]


def test_a_copy_stays_where_the_register_holds_something_else_on_another_way_there(linked):
    code = f"""
    in   r26, {IN}
    in   r27, {IN}
    movw r30, r26
    sbiw r26, 1
    breq 1f
    movw r30, r26
1:  ld   r24, Z
    movw r30, r26
    ldd  r25, Z+2
    {sink('r24', 'r25')}
    ret
"""
    assert "movw r30, r26" in linked(f=code)("f")[-5:]


def test_zero_is_taken_from_r1(linked):
    code = f"    ldi r24, 0\n    out {OUT}, r24\n    ret\n"
    assert linked(f=code)("f") == [f"out {OUT}, r1", "ret"]


def test_zero_is_not_taken_from_r1_where_a_product_is_in_it(linked):
    code = f"    in r24, {IN}\n    mul r24, r24\n    ldi r25, 0\n    out {OUT}, r25\n    out {OUT}, r1\n    eor r1, r1\n    ret\n"
    assert f"out {OUT}, r25" in linked(f=code)("f")


def test_r1_is_not_trusted_if_a_function_is_called_with_something_else_in_it(linked):
    caller = f"    in r24, {IN}\n    mul r24, r24\n    call g\n    out {OUT}, r1\n    eor r1, r1\n    ret\n"
    assert "ldi r24, 0x00" in linked(f=caller, g=f"    ldi r24, 0\n    out {OUT}, r24\n    ret\n")("g")


def test_r1_is_cleared_behind_a_product_before_a_return_though_nobody_reads_it_yet(linked):
    code = f"    in r24, {IN}\n    mul r24, r24\n    movw r24, r0\n    eor r1, r1\n{sink('r24', 'r25')}    ret\n"
    assert "eor r1, r1" in linked(f=code)("f")


def test_a_comparison_that_cannot_be_equal_says_nothing_of_r1(linked):
    """The copy of r1 is not 5 behind the branch, which is never taken, and so neither is r1."""
    code = f"    mov r24, r1\n    cpi r24, 5\n    breq 1f\n    out {OUT}, r24\n1:  ldi r25, 0\n    out {OUT}, r25\n    ret\n"
    assert linked(f=code)("f").count(f"out {OUT}, r1") == 2


def test_a_number_that_is_there_already_is_not_loaded_again(linked):
    code = f"    ldi r24, 7\n    out {OUT}, r24\n    ldi r24, 7\n    out {OUT}, r24\n    ret\n"
    assert linked(f=code)("f").count("ldi r24, 0x07") == 1


def test_a_number_is_loaded_again_behind_a_label_that_is_reached_with_another(linked):
    code = f"""
    in   r25, {IN}
    ldi  r24, 7
    cpi  r25, 9
    brcs 1f
    ldi  r24, 8
    out  {OUT}, r24
1:  ldi  r24, 7
    out  {OUT}, r24
    ret
"""
    assert linked(f=code)("f").count("ldi r24, 0x07") == 1 and "ldi r24, 0x08" in linked(f=code)("f")


DECREMENTED = f"""
    in   r24, {IN}
    {{work_out}}
    out  {OUT}, r24
    cpi  r24, 0
    {{branch}} 1f
    wdr
    wdr
1:  sleep
    ret
"""


def test_a_comparison_with_zero_that_has_been_made_goes(linked):
    assert "cpi r24, 0x00" not in linked(f=DECREMENTED.format(work_out="dec r24", branch="breq"))("f")


@pytest.mark.parametrize("work_out, branch", [("dec r24", "brge"), ("sbc r24, r1", "breq"), ("mov r25, r24", "breq")])
def test_a_comparison_with_zero_that_says_something_else_stays(linked, work_out, branch):
    """The sign of a comparison is not that of a decrement, which may overflow; Z of a subtraction with a carry is of more than one byte."""
    assert "cpi r24, 0x00" in linked(f=DECREMENTED.format(work_out=work_out, branch=branch))("f")


def test_what_is_copied_and_not_read_again_is_made_where_it_is_wanted(linked):
    code = f"    in r18, {IN}\n    inc r18\n    mov r24, r18\n    out {OUT}, r24\n    ret\n"
    program = linked(f=code)("f")
    assert len(program) == 4 and not [one for one in program if one.startswith("mov")]


def test_what_is_copied_and_changed_while_the_original_is_read_again_stays_copied(linked):
    code = f"    in r18, {IN}\n    mov r24, r18\n    inc r24\n{sink('r24', 'r18')}    ret\n"
    assert "mov r24, r18" in linked(f=code)("f")


def test_a_copy_goes_though_its_original_is_made_on_two_ways(linked):
    code = f"""
    in   r24, {IN}
    cpi  r24, 3
    brcs 1f
    in   r18, {IN}
    rjmp 2f
1:  in   r18, {OUT}
2:  mov  r19, r18
    inc  r19
    out  {OUT}, r19
    ret
"""
    assert not [one for one in linked(f=code)("f") if one.startswith("mov")]


def test_what_a_call_returns_is_not_looked_for_in_another_register(linked):
    """The original is made by a call on one of two ways: it is copied from where the call leaves it."""
    code = f"""
    in   r20, {IN}
    in   r24, {IN}
    cpi  r24, 3
    brcs 1f
    call g
1:  mov  r18, r24
    in   r24, {IN}
    add  r18, r24
    out  {OUT}, r18
    ret
"""
    program = linked(f=code, g=f"    in r24, {IN}\n    swap r24\n    ret\n")
    call = next(n for n, one in enumerate(program("f")) if "call" in one)
    assert "mov r18, r24" in program("f")[call:]


def test_an_original_stays_where_the_other_register_is_needed_at_the_same_time(linked):
    code = f"    in r18, {IN}\n    in r24, {OUT}\n    out {OUT}, r24\n    add r24, r18\n    out {OUT}, r24\n    mov r24, r18\n    inc r24\n    out {OUT}, r24\n    ret\n"
    program = linked(f=code)("f")
    assert program[:2] == [f"in r18, {IN}", f"in r24, {OUT}"] and "add r24, r18" in program


def test_jumps_go_where_they_lead_to(linked):
    code = f"    in r24, {IN}\n    cpi r24, 3\n    brcs 1f\n    out {OUT}, r24\n    rjmp 2f\n1:  wdr\n2:  rjmp 3f\n    nop\n3:  ret\n"
    program = linked(f=code)("f")
    assert not [one for one in program if one.startswith(("rjmp", "nop"))]


def test_of_equal_ends_one_is_left(linked):
    end = f"    swap r24\n    out {OUT}, r24\n    com r24\n    out {OUT}, r24\n    ret\n"
    code = f"    in r24, {IN}\n    cpi r24, 3\n    brcs 1f\n    wdr\n{end}1:  sleep\n{end}"
    program = linked(f=code)("f")
    assert program.count("swap r24") == 1 and [one for one in program if one.startswith("rjmp")]


def test_ends_that_differ_are_left(linked):
    def end(register):
        return f"    swap {register}\n    out {OUT}, {register}\n    com {register}\n    out {OUT}, {register}\n    ret\n"

    code = f"    in r24, {IN}\n    in r25, {IN}\n    cpi r24, 3\n    brcs 1f\n    wdr\n{end('r24')}1:  sleep\n{end('r25')}"
    program = linked(f=code)("f")
    assert "swap r24" in program and "swap r25" in program


def test_a_pair_is_copied_at_once(linked):
    code = f"    in r18, {IN}\n    in r19, {IN}\n    call g\n{sink('r18', 'r19')}    ret\n"
    copying = f"    in r22, {IN}\n    mov r24, r18\n    mov r25, r19\n    add r24, r22\n    adc r25, r1\n{sink('r24', 'r25')}    ret\n"
    assert "movw r24, r18" in linked(f=code, g=copying)("g")


def test_a_small_number_is_added_to_a_pair_at_once_unless_the_carry_is_read(linked):
    def code(rest):
        return f"    in r24, {IN}\n    in r25, {IN}\n    subi r24, 0xFE\n    sbci r25, 0xFF\n{rest}{sink('r24', 'r25')}    ret\n"

    assert "adiw r24, 0x02" in linked(f=code(""))("f")
    assert "sbci r25, 0xFF" in linked(f=code("    brcs 1f\n    wdr\n1:\n"))("f")


TESTED = f"""
    in   r24, {IN}
    mov  r25, r24
    andi r25, 0x40
    breq 1f
    out  {OUT}, r24
1:  out  {OUT}, {{read}}
    ret
"""


def test_a_bit_is_tested_by_a_skip(linked):
    assert linked(f=TESTED.format(read="r24"))("f") == [f"in r24, {IN}", "sbrc r24, 6", f"out {OUT}, r24", f"out {OUT}, r24", "ret"]


def test_a_bit_that_is_read_again_is_worked_out(linked):
    program = linked(f=TESTED.format(read="r25"))("f")
    assert "andi r25, 0x40" in program and not [one for one in program if one.startswith("sbr")]


def test_a_call_before_a_return_is_not_skipped(linked):
    """ld makes a jump of the two: what is skipped to would be gone."""
    code = f"    in r24, {IN}\n    andi r24, 1\n    breq 1f\n    call g\n1:  ret\n"
    program = linked(f=code, g="    wdr\n    sleep\n    ret\n")("f")
    assert not [one for one in program if one.startswith("sbr")]


def test_a_function_that_skips_is_left_alone(linked):
    code = f"    in r24, {IN}\n    sbrc r24, 1\n    ldi r25, 7\n    ldi r25, 7\n    out {OUT}, r24\n    ret\n"
    assert linked(f=code)("f").count("ldi r25, 0x07") == 2


# Four instructions that something else is around, in three functions.
COMMON = "    lds r24, some\n    swap r24\n    inc r24\n    sts other, r24\n"
VARIABLES = "".join(f'    .section .bss.{name},"aw",@nobits\n    .type {name},@object\n    .size {name}, 1\n{name}: .zero 1\n' for name in ("some", "other"))
THREE = {
    "f": f"    sleep\n    call g\n{COMMON}    call h\n    sleep\n    ret\n",
    "g": f"    wdr\n{COMMON}    wdr\n    ret\n",
    "h": f"    cli\n{COMMON}    sei\n    ret\n",
}


def copies(program, instruction="swap r24"):
    return {name: program(name).count(instruction) for name in "fgh"}


def test_of_code_that_occurs_in_several_functions_one_is_left_and_called(linked):
    program = linked(also=VARIABLES, **THREE)
    assert sum(copies(program).values()) == 1
    owner = next(name for name, count in copies(program).items() if count)
    # It is behind one of them, with a return, and does what it did.
    assert [one.split()[0] for one in program(owner)[-5:]] in (["ldd", "swap", "inc", "std", "ret"], ["ld", "swap", "inc", "std", "ret"])
    assert program(owner).count("ret") == 2
    assert [re.sub(r" .*", "", one) for one in program("h")[:4]] == ["cli", "rcall", "sei", "ret"]


def test_a_function_that_ends_with_it_is_called_there(linked):
    """Its return is theirs: no copy is made."""
    ending = {**THREE, "g": f"    wdr\n{COMMON}    ret\n"}
    program = linked(also=VARIABLES, **ending)
    assert copies(program) == {"f": 0, "g": 1, "h": 0}
    assert program("g")[-1] == "ret" and program("g").count("ret") == 1


def test_of_equal_ends_of_two_functions_one_is_jumped_to(linked):
    end = {"f": f"    call g\n    call h\n    ret\n", "g": f"    wdr\n{COMMON}    ret\n", "h": f"    cli\n{COMMON}    ret\n"}
    program = linked(also=VARIABLES, **end)
    assert sorted(copies(program).values()) == [0, 0, 1]
    without = program("h") if program("h").count("swap r24") == 0 else program("g")
    assert re.match(r"rjmp ", without[-1]) and len(without) == 2


def test_functions_that_have_to_be_quick_keep_their_code(linked):
    program = linked(also=VARIABLES, quick="# these two\nf\n\nh\n", **THREE)
    assert copies(program) == {"f": 1, "g": 1, "h": 1}
    program = linked(also=VARIABLES, quick="h\n", **THREE)
    assert copies(program)["h"] == 1 and not [one for one in program("h") if "call" in one]


def test_a_name_of_a_quick_function_that_does_not_exist_is_an_error(linked, capfd):
    with pytest.raises(subprocess.CalledProcessError):
        linked(also=VARIABLES, quick="f\nnobody\n", **THREE)
    assert "there is no function nobody" in capfd.readouterr().err


def test_a_list_of_quick_functions_that_is_not_there_is_an_error():
    linker = subprocess.run([ROOT / "scripts" / "link-small", "--quick=/nowhere/quick.txt", "some.o"], capture_output=True, text=True)
    assert linker.returncode == 1
    assert linker.stderr == "link-small: the list of the functions that have to be quick, /nowhere/quick.txt: No such file or directory\n"


def test_loops_keep_their_code(linked):
    def loop(name):
        return f"    ldi r20, 7\n1:  wdr\n{COMMON}    dec r20\n    brne 1b\n    {name}\n    ret\n"

    program = linked(also=VARIABLES, f=f"    call g\n    call h\n{loop('wdr')}", g=loop("sei"), h=loop("cli"))
    assert copies(program) == {"f": 1, "g": 1, "h": 1}


def test_code_that_something_jumps_into_stays(linked):
    def jumping(name):
        return f"    in r25, {IN}\n    {name}\n    cpi r25, 3\n    brcs 1f\n    lds r24, some\n    swap r24\n1:  inc r24\n    sts other, r24\n    {name}\n    ret\n"

    program = linked(also=VARIABLES, f=f"    call g\n    call h\n{jumping('wdr')}", g=jumping("sei"), h=jumping("cli"))
    assert copies(program) == {"f": 1, "g": 1, "h": 1}


def test_nothing_comes_between_ports_that_are_written_shortly_after_each_other(linked):
    """EEPE must be set within four cycles of EEMPE."""

    def writing(bit):
        return f"    wdr\n    sbi 0x1F, {bit}\n    swap r24\n    com r24\n    inc r24\n    out 0x1F, r24\n    ret\n"

    program = linked(f=f"    in r24, {IN}\n    call g\n    call h\n{writing(2)}", g=writing(3), h=writing(4))
    for name, bit in ("f", 2), ("g", 3), ("h", 4):
        at = program(name).index(f"sbi 0x1f, {bit}")
        assert program(name)[at + 1 : at + 5] == ["swap r24", "com r24", "inc r24", "out 0x1f, r24"]


WRITING = "    nop\n    nop\n    nop\n    swap r24\n    com r24\n    inc r24\n    out 0x1F, r24\n    nop\n    nop\n    nop\n    nop\n"


def test_a_port_in_code_that_is_called_is_written_once_each_time(linked):
    def writing(name):
        return f"    {name}\n    lds r24, some\n{WRITING}    {name}\n    ret\n"

    program = linked(also=VARIABLES, f=f"    call g\n    call h\n{writing('wdr')}", g=writing("sei"), h=writing("cli"))
    assert sum(copies(program, "out 0x1f, r24").values()) == 1


def test_a_function_that_refers_to_nothing_keeps_its_code(linked):
    """There is no place in the object for the relocation of a call."""

    def writing(name):
        return f"    {name}\n{WRITING}    {name}\n    ret\n"

    program = linked(f=f"    in r24, {IN}\n    call g\n    call h\n{writing('wdr')}", g=writing("sei"), h=writing("cli"))
    for name in "gh":
        assert program(name).count("out 0x1f, r24") == 1 and not [one for one in program(name) if re.match("r?jmp|r?call", one)]


def test_the_linker_keeps_the_order_of_the_functions(tmp_path, monkeypatch):
    """It takes a section when it comes upon its relocations, if that is earlier; some functions have none."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    from link_small.elf import Object, executed
    from link_small.order import rearrange

    names = [f"f{n}" for n in range(9)]
    code = "".join(f'    .section .text.{name},"ax",@progbits\n    .global {name}\n{name}:\n{"    call f0" if n % 3 else "    nop"}\n    ret\n' for n, name in enumerate(names))
    (tmp_path / "some.s").write_text(code)
    subprocess.run(["avr-gcc", "-mmcu=atmega168", "-c", tmp_path / "some.s", "-o", tmp_path / "some.o"], check=True)
    object = Object((tmp_path / "some.o").read_bytes())
    wanted = ["f4", "f0", "f8", "f2", "f6", "f5", "f1", "f7", "f3"]
    sections = {section.name.removeprefix(".text."): section for section in executed(object)}
    rearrange(object, [sections[name] for name in wanted])
    (tmp_path / "other.o").write_bytes(object.elf)
    subprocess.run(["avr-gcc", "-mmcu=atmega168", "-nostartfiles", tmp_path / "other.o", "-o", tmp_path / "program.elf"], check=True)
    found = addresses(tmp_path)
    assert sorted(names, key=found.get) == wanted
    listing = subprocess.run(["avr-objdump", "-d", "--no-show-raw-insn", tmp_path / "program.elf"], check=True, capture_output=True, text=True).stdout
    assert len(re.findall(r"call\s+0x\w+\s+; 0x\w+ <f0>", listing)) == 6, "their relocations went along"


# Sixty-four bytes that are used more than any others, so that Y points to them, and four more.
USED_MOST = '    .section .bss.most,"aw",@nobits\n    .type most,@object\n    .size most, 64\nmost: .zero 64\n'
FAR = '    .section .bss.far,"aw",@nobits\n    .type far,@object\n    .size far, 80\nfar: .zero 80\n'
USING_MOST = "".join(f"    lds r24, most+{n}\n    sts most+{n}, r24\n" for n in range(64)) + "    ret\n"


def loads(*places):
    return "".join(f"    lds r{18 + n}, far+{place}\n" for n, place in enumerate(places)) + sink(*(f"r{18 + n}" for n in range(len(places))))


@pytest.fixture
def with_far_variables(linked, tmp_path):
    """The instructions of `f`, and where the variables are that Y does not reach."""

    def link(code, **functions):
        program = linked(also=USED_MOST + FAR, f=f"    call most_used\n{code}", most_used=USING_MOST, **functions)
        return program("f"), addresses(tmp_path)["far"] & 0xFFFF

    return link


def test_variables_near_each_other_are_reached_through_z(with_far_variables):
    code, far = with_far_variables(loads(3, 0, 63) + "    ret\n")
    assert code[1:6] == [f"ldi r30, 0x{far & 0xFF:02X}", f"ldi r31, 0x{far >> 8:02X}", "ldd r18, Z+3", "ld r19, Z", "ldd r20, Z+63"]


def test_two_are_too_few_and_those_out_of_reach_are_left(with_far_variables):
    code, _ = with_far_variables(loads(0, 1) + "    ret\n")
    assert not [one for one in code if "Z" in one]
    code, _ = with_far_variables(loads(0, 1, 2, 70) + "    ret\n")
    assert [one.split()[0] for one in code[1:7]] == ["ldi", "ldi", "ld", "ldd", "ldd", "lds"]


def test_a_branch_away_may_come_between(with_far_variables):
    code, _ = with_far_variables(f"    lds r18, far\n    lds r19, far+1\n    cp r18, r19\n    breq 1f\n    lds r18, far+2\n{sink('r18')}1:  ret\n")
    assert [one.split()[0] for one in code[1:8]] == ["ldi", "ldi", "ld", "ldd", "cp", "breq", "ldd"]


def test_z_is_left_to_those_who_need_it(with_far_variables):
    code, _ = with_far_variables(f"    in r30, {IN}\n{loads(0, 1, 2, 3)}{sink('r30')}    ret\n")
    assert len([one for one in code if one.startswith("lds")]) == 4
    for between in f"    in r30, {IN}\n{sink('r30')}", "    call g\n":
        code, _ = with_far_variables(f"{loads(0, 1)}{between}{loads(2, 3)}    ret\n", g=f"    in r30, {IN}\n{sink('r30')}    ret\n")
        assert len([one for one in code if one.startswith("lds")]) == 4
    code, _ = with_far_variables(f"{loads(0, 1)}    call g\n{loads(2, 3)}    ret\n", g=f"    in r26, {IN}\n{sink('r26')}    ret\n")
    assert not [one for one in code if one.startswith("lds")]


def test_who_comes_from_elsewhere_finds_z_set(with_far_variables):
    code, _ = with_far_variables(f"    in r24, {IN}\n    cpi r24, 3\n    breq 1f\n{loads(0, 1)}1:\n{loads(2, 3)}    ret\n")
    assert not [one for one in code if "Z" in one]
    # Where he comes to the first of them.
    code, _ = with_far_variables(f"1:\n{loads(0, 1, 2)}    in r24, {IN}\n    cpi r24, 3\n    breq 1b\n    ret\n")
    jump = next(one for one in code if one.startswith("breq"))
    assert int(jump.split(".")[1]) == -2 * (code.index(jump) + 1 - code.index(next(one for one in code if one.startswith("ldi"))))


def test_a_skip_skips_what_it_did(with_far_variables):
    code, _ = with_far_variables(f"    in r24, {IN}\n    sbrc r24, 0\n{loads(0, 1, 2, 3)}    ret\n")
    at = next(n for n, one in enumerate(code) if one.startswith("sbrc"))
    assert [one.split()[0] for one in code[at + 1 : at + 7]] == ["lds", "ldi", "ldi", "ld", "ldd", "ldd"]
