//! Tests of lists, reads and writes of parameters.

use super::rig::*;

#[test]
fn all_parameters_are_fetched_although_every_third_request_is_lost() {
    let mut rig = Rig::with_node(40);
    rig.node().lose_every = Some(3);
    rig.list(42);
    rig.run_ms(20_000);
    assert_eq!(rig.parameters().len(), 40);
}

#[test]
fn a_list_requested_twice_is_fetched_once_and_component_0_is_all_nodes() {
    let mut rig = Rig::online(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    let before = rig.node().requests;
    rig.list(0);
    rig.list(0);
    rig.run_ms(200);
    assert_eq!(rig.parameters().len(), 8);
    // Up to four requests are unanswered when the end of the list is found.
    assert!((6..=10).contains(&(rig.node().requests - before)));
}

#[test]
fn an_unknown_parameter_is_reported_to_the_sender() {
    let mut rig = Rig::with_node(3);
    rig.read("NONE");
    rig.read_at(3);
    rig.set("NONE", 1.0, INT32);
    rig.run_ms(100);
    let sent = rig.sent_messages();
    assert_eq!(errors(&sent), [MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST; 3]);
    assert_eq!(sent.len(), 3);
}

#[test]
fn a_set_parameter_is_sent_to_all_stations_with_the_node_s_value() {
    let mut rig = Rig::with_node(3);
    rig.set_integer("PARAM_1", 1900);
    rig.run_ms(100);
    let to_all = |(_, post): &(Duration, Post)| {
        matches!(
            post,
            Post::Message { to: To::All, class: Class::Answer, out }
                if matches!(out.content, Content::Parameter { .. })
        )
    };
    assert_eq!(rig.posts.iter().filter(|post| to_all(post)).count(), 1);
    assert_eq!(rig.parameters(), [(String::from("PARAM_1"), Number::Int32(1900), 3, 1)]);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(1900));
    rig.set_integer("PARAM_1", 9999);
    rig.run_ms(100);
    let sent = rig.sent_messages();
    assert_eq!(errors(&sent), [MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE]);
    assert!(matches!(&sent[0].1, Content::Parameter { number: Number::Int32(5000), .. }));
}

#[test]
fn a_list_of_a_silent_node_fails_in_bounded_time() {
    let mut rig = Rig::with_node(3);
    rig.node().lose_every = Some(1);
    rig.read("PARAM_1");
    rig.list(42);
    rig.run_ms(4100);
    let sent = rig.sent_messages();
    assert_eq!(errors(&sent), [MavParamError::MAV_PARAM_ERROR_READ_FAIL]);
    assert_eq!(texts(&sent), ["Node 42 does not send its parameters"]);
    rig.node().lose_every = None;
    rig.list(42);
    rig.run_ms(500);
    assert_eq!(rig.parameters().len(), 3);
}

#[test]
fn a_restart_during_a_list_starts_it_again() {
    let mut rig = Rig::with_node(100);
    rig.run_ms(4490);
    rig.sent_messages();
    rig.list(42);
    rig.run_ms(8);
    rig.node().uptime_s = 0;
    rig.node().parameters.truncate(60);
    rig.run_ms(1000);
    let parameters = rig.parameters();
    assert_eq!((parameters.len(), parameters[0].2), (60, 60));
}

#[test]
fn autosave_saves_once_after_the_last_change() {
    let mut rig = Rig::with_node(3);
    rig.bridge.state.settings.autosave = Some(Duration::from_secs(2));
    for value in 1..=3 {
        rig.set_integer("PARAM_1", value);
        rig.run_ms(1500);
        assert_eq!(rig.node().saved, 0);
    }
    rig.run_ms(5000);
    assert_eq!(rig.node().saved, 1);
}

#[test]
fn text_and_nan_are_rejected_with_the_reason() {
    let mut rig = Rig::with_node(3);
    rig.node().parameters[0].value = Value::Text(b"left".to_vec());
    rig.node().parameters[2].value = Value::Real(1.5);
    rig.read("PARAM_0");
    rig.set("PARAM_0", 1.0, INT32);
    rig.run_ms(100);
    assert_eq!(errors(&rig.sent_messages()), [MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED; 2]);
    rig.set("PARAM_2", f32::NAN, 9);
    rig.run_ms(100);
    assert_eq!(errors(&rig.sent_messages()), [MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH]);
    assert_eq!(rig.node().parameters[2].value, Value::Real(1.5));
}

#[test]
fn a_list_of_a_node_without_parameters_is_answered_with_a_text() {
    let mut rig = Rig::with_node(0);
    rig.list(42);
    rig.run_ms(100);
    assert_eq!(texts(&rig.sent_messages()), ["Node 42 has no parameters"]);
}
