//! Requests during a save, which takes up to 0.4 s, for firmwares with the feature `save-answers`.

use bench::dronecan::{Message, Opcode, ParameterRequest};
use rig::manage::{SAVE_TIMEOUT_MS, integer};
use rig::{Program, Rig};

const PROGRAM: Program = Program::Full;

/// A node with so many changes that its next save writes every byte.
fn changed() -> Rig {
    let mut rig = PROGRAM.running();
    rig.set_all(&[
        ("OUT1_MIN", 1100),
        ("OUT1_MAX", 1900),
        ("OUT1_TRIM", 1400),
        ("TEMP_ID", 0x1234),
    ]);
    rig.forget();
    rig
}

fn is_saved(answer: &Message) -> Option<bool> {
    match answer {
        Message::OpcodeExecuted(ok) => Some(*ok),
        _ => None,
    }
}

/// ArduPilot waits 100 ms for an answer to a GetSet.
#[test]
fn requests_are_answered_within_20_ms_while_the_parameters_are_saved() {
    let mut rig = changed();
    rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
    rig.run_ms(2);
    let mut asked = 0;
    let saved = |rig: &Rig| rig.answers().iter().find_map(|(_, _, answer)| is_saved(answer));
    while saved(&rig).is_none() {
        let request =
            ParameterRequest { name: b"OUT1_MIN".to_vec(), ..ParameterRequest::default() };
        let number = rig.request(&Message::ParameterRequest(request));
        let seen = rig.answers().len();
        rig.wait_for("the value of OUT1_MIN", 20, |rig| {
            rig.answers()[seen..].iter().any(|(_, answered, answer)| {
                let is_value =
                    matches!(answer, Message::ParameterResponse(of) if integer(&of.value) == 1100);
                *answered == number && is_value
            })
        });
        asked += 1;
    }
    assert!(asked >= 5, "{asked} questions while it was saved");
    assert_eq!(saved(&rig), Some(true));
    rig.cut_power();
    rig.wait_until_up();
    assert_eq!((rig.get("OUT1_MIN"), rig.get("TEMP_ID")), (1100, 0x1234));
}

#[test]
fn a_restart_requested_during_a_save_waits_for_its_end() {
    let mut rig = changed();
    let save = rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
    let restart = rig.request(&Message::RestartNode(0xAC_CE55_1B1E));
    rig.wait_for("both answers", SAVE_TIMEOUT_MS, |rig| rig.answers().len() == 2);
    let answers = rig.answers();
    let of =
        |number| answers.iter().find(|(_, other, _)| *other == number).map(|(_, _, answer)| answer);
    assert_eq!(of(save).and_then(is_saved), Some(true));
    assert!(of(restart).is_some());
    rig.wait_for_line("reset: on request", 200);
    rig.wait_until_up();
    assert_eq!(rig.get("OUT1_MIN"), 1100);
}

#[test]
fn eight_requests_after_a_save_are_all_answered_before_its_end() {
    let mut rig = changed();
    let save = rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
    for _ in 0..7 {
        rig.request(&Message::NodeInfoRequest);
    }
    rig.wait_for("all answers", SAVE_TIMEOUT_MS, |rig| rig.answers().len() == 8);
    assert_eq!(rig.answers().last().expect("eight").1, save);
}
