//! What the simulator says about features of the chip that it does not model exactly.

use crate::avr::{MS, program};

/// What the program of this statement uses, and the number of mistakes.
#[track_caller]
fn used(statement: &str) -> (Vec<&'static str>, usize) {
    let mut avr = program("features", &[&format!("FEATURE={statement}")]);
    avr.run_until(10 * MS);
    let texts = avr.unmodelled_after(0).into_iter().map(|unmodelled| unmodelled.text).collect();
    (texts, avr.take_violations().len())
}

#[test]
fn each_feature_is_reported_once() {
    for (statement, part, mistakes) in [
        ("CLKPR=1<<CLKPCE,CLKPR=3", "CLKPR", 0),
        ("ACSR=1<<ACIE", "comparator", 0),
        ("ADCSRB=1<<ACME", "comparator", 0),
        ("(void)ACSR", "comparator", 0),
        ("ADCSRB=4,ADCSRA=1<<ADEN|1<<ADATE", "auto trigger", 0),
        ("ADMUX=8,ADCSRA=1<<ADEN|1<<ADSC", "temperature sensor", 0),
        ("TWAR=0x20", "TWI", 0),
        ("PRR=1<<PRADC|1<<PRTIM0", "PRR", 0),
        ("UCSR0B=1<<UCSZ02", "nine bits", 1),
        ("UCSR0C=1<<UMSEL00", "synchronous", 1),
        ("SPCR=1<<SPE", "slave", 1),
        ("TCCR0B=7,TCCR0B=7", "T0 or T1", 2),
        ("TCCR1B=6", "T0 or T1", 1),
        ("TCCR2B=1<<WGM22|1", "reserved mode", 0),
        ("TCCR1A=1;TCCR1B=3<<WGM12|1", "reserved mode", 0),
        ("ASSR=1<<AS2", "own crystal", 1),
        ("ADCSRA=1<<ADEN|1<<ADSC;set_sleep_mode(SLEEP_MODE_PWR_DOWN);sleep_mode()", "at work", 0),
    ] {
        let (texts, found) = used(statement);
        assert!(texts.len() == 1 && texts[0].contains(part), "{statement}: {texts:?}");
        assert!(found <= mistakes, "{statement}: {found} mistakes");
    }
}

#[test]
fn what_is_modelled_is_not_reported() {
    for statement in [
        "CLKPR=1<<CLKPCE,CLKPR=0",
        "ACSR=1<<ACD",
        "ADMUX=1,ADCSRA=1<<ADEN|1<<ADSC",
        "ADCSRB=0,ADCSRA=1<<ADEN|1<<ADATE|1<<ADSC",
        "PRR=1<<PRTIM0|1<<PRTIM1|1<<PRTIM2",
        "UCSR0C=3<<UCSZ00",
        "TCCR0A=3,TCCR0B=1<<WGM02|1",
        "TWAR=0xFE,TWCR=1<<TWEN",
        "TCCR1A=1;TCCR1B=1<<WGM12|1",
        "set_sleep_mode(SLEEP_MODE_IDLE);sleep_mode()",
        "set_sleep_mode(SLEEP_MODE_PWR_DOWN);sleep_mode()",
    ] {
        assert_eq!(used(statement).0, [""; 0], "{statement}");
    }
}

/// MCUSR, the registers and the reset counters do not show it.
#[test]
fn a_jump_to_the_start_is_noticed() {
    let mut avr = program("features", &["FEATURE=DDRB=1", "JUMP"]);
    let starts = crate::avr::address(&avr, "starts");
    avr.poke_sram(starts, 0);
    avr.run_until(10 * MS);
    let jumps = avr.jumps_after(0);
    assert_eq!((jumps.len(), avr.resets().len()), (2, 1), "{jumps:?}");
    assert!(jumps[1] - jumps[0] > MS);
    assert_eq!(avr.jumps_after(2), []);
    avr.reset(bench::avr::ResetCause::External);
    avr.run_until(11 * MS);
    assert_eq!(avr.jumps_after(2), [], "a reset is no jump");
}

/// A read of the port counts for each pin; an instruction that tests a bit for that bit only.
#[test]
fn the_pins_that_a_program_reads_are_known() {
    for (statement, d2, d3) in [
        ("DDRB=1", false, false),
        ("DDRB=PIND", true, true),
        ("if(PIND&4)DDRB=2", true, false),
        ("EIMSK=2", false, true),
        ("PCICR=4;PCMSK2=4", true, false),
    ] {
        let mut avr = program("features", &[&format!("FEATURE={statement}")]);
        avr.run_until(MS);
        let observed = [2, 3].map(|bit| avr.observes_pin('D', bit));
        assert_eq!(observed, [d2, d3], "{statement}");
    }
}
