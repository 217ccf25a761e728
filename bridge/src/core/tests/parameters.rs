//! Lists, reads and writes of parameters.

use super::rig::*;

#[test]
fn all_parameters_come_in_order_with_their_count() {
    let mut rig = Rig::with_node(26);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(200);
    let parameters = rig.parameters();
    assert_eq!(parameters.len(), 26);
    for (at, parameter) in parameters.iter().enumerate() {
        let expected = (format!("PARAM_{at}"), Number::Int32(at as i32 * 10), 26, at as u16);
        assert_eq!(*parameter, expected);
    }
}

#[test]
fn a_node_that_loses_every_third_request_still_tells_all() {
    let mut rig = Rig::with_node(40);
    rig.node().lose_every = Some(3);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(20_000);
    assert_eq!(rig.parameters().len(), 40);
}

#[test]
fn a_list_that_is_asked_for_twice_is_fetched_once_and_component_0_means_all_nodes() {
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.run_ms(1500);
    rig.said();
    let before = rig.node().requests;
    rig.say((1, 0), Request::ParameterList);
    rig.say((1, 0), Request::ParameterList);
    rig.run_ms(200);
    assert_eq!(rig.parameters().len(), 8);
    // Up to four are on their way when the end is found.
    assert!((6..=10).contains(&(rig.node().requests - before)));
}

#[test]
fn a_parameter_is_read_by_index_and_by_name_and_told_with_its_index() {
    let mut rig = Rig::with_node(10);
    rig.say((1, 42), Request::ParameterRead { index: Some(3), name: String::new() });
    rig.say((0, 42), Request::ParameterRead { index: None, name: "PARAM_7".into() });
    rig.run_ms(100);
    let expected = |at: u16| (format!("PARAM_{at}"), Number::Int32(i32::from(at) * 10), 10, at);
    assert_eq!(rig.parameters(), [expected(3), expected(7)]);
}

#[test]
fn what_is_not_there_is_told_to_whoever_asked() {
    let mut rig = Rig::with_node(3);
    rig.say((1, 42), Request::ParameterRead { index: None, name: "NONE".into() });
    rig.say((1, 42), Request::ParameterRead { index: Some(3), name: String::new() });
    rig.say((1, 42), Request::ParameterSet { name: "NONE".into(), value: 1.0, kind: INT32 });
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST; 3]);
    assert_eq!(said.len(), 3);
}

#[test]
fn a_set_parameter_is_told_to_all_with_the_value_in_force() {
    let mut rig = Rig::with_node(3);
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(1900), kind: INT32 });
    rig.run_ms(100);
    let to_all = |(_, post): &(Duration, Post)| matches!(post, Post::Message { to: To::All, class: Class::Answer, out } if matches!(out.content, Content::Parameter { .. }));
    assert_eq!(rig.posts.iter().filter(|post| to_all(post)).count(), 1);
    assert_eq!(rig.parameters(), [(String::from("PARAM_1"), Number::Int32(1900), 3, 1)]);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(1900));
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(9999), kind: INT32 });
    rig.run_ms(100);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE]);
    assert!(matches!(&said[0].1, Content::Parameter { number: Number::Int32(5000), .. }));
}

#[test]
fn a_value_of_no_use_changes_nothing_and_is_answered_with_what_is_in_force() {
    let mut rig = Rig::with_node(3);
    for (value, kind) in [(0.5, 9), (f32::NAN, 9), (1.0, 10), (1.0, 0), (1.0, 99)] {
        rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value, kind });
        rig.run_ms(100);
        let said = rig.said();
        assert_eq!((errors(&said).len(), said.len()), (1, 2), "{said:?}");
        assert!(matches!(&said[0].1, Content::Parameter { number: Number::Int32(10), .. }));
    }
    // All nodes at once are not meant.
    rig.say((1, 0), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(5), kind: INT32 });
    rig.run_ms(100);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(10));
}

#[test]
fn a_node_that_does_not_answer_is_given_up_in_bounded_time() {
    let mut rig = Rig::with_node(3);
    rig.node().lose_every = Some(1);
    rig.say((1, 42), Request::ParameterRead { index: None, name: "PARAM_1".into() });
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(4100);
    let said = rig.said();
    assert_eq!(errors(&said), [MavParamError::MAV_PARAM_ERROR_READ_FAIL]);
    assert_eq!(texts(&said), ["Node 42 does not send its parameters"]);
    rig.node().lose_every = None;
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(500);
    assert_eq!(rig.parameters().len(), 3);
}

#[test]
fn long_names_are_shortened_and_set_under_their_short_name_in_any_case() {
    let mut rig = Rig::with_node(2);
    rig.node().parameters[0].name = b"uavcan.equipment.esc.current_limit_max".to_vec();
    rig.node().parameters[1].name = b"uavcan.equipment.esc.current_limit_min".to_vec();
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(100);
    let short: Vec<String> = rig.parameters().into_iter().map(|parameter| parameter.0).collect();
    assert!(short.iter().all(|name| name.len() == 16) && short[0] != short[1]);
    let name = short[1].to_ascii_uppercase();
    rig.say((1, 42), Request::ParameterSet { name, value: f32::from_bits(77), kind: INT32 });
    rig.run_ms(100);
    assert_eq!(rig.node().parameters[1].value, Value::Integer(77));
    assert_eq!(rig.node().parameters[0].value, Value::Integer(0));
}

#[test]
fn a_restart_in_the_middle_of_a_list_begins_it_again() {
    let mut rig = Rig::with_node(100);
    rig.run_ms(4490);
    rig.said();
    rig.say((1, 42), Request::ParameterList);
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
        rig.say((1, 42), Request::ParameterSet { name: "PARAM_1".into(), value: f32::from_bits(value), kind: INT32 });
        rig.run_ms(1500);
        assert_eq!(rig.node().saved, 0);
    }
    rig.run_ms(5000);
    assert_eq!(rig.node().saved, 1);
}

#[test]
fn a_parameter_of_text_and_nan_are_refused_with_the_reason() {
    let mut rig = Rig::with_node(3);
    rig.node().parameters[0].value = Value::Text(b"left".to_vec());
    rig.node().parameters[2].value = Value::Real(1.5);
    rig.say((1, 42), Request::ParameterRead { index: None, name: "PARAM_0".into() });
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_0".into(), value: 1.0, kind: INT32 });
    rig.run_ms(100);
    assert_eq!(errors(&rig.said()), [MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED; 2]);
    rig.say((1, 42), Request::ParameterSet { name: "PARAM_2".into(), value: f32::NAN, kind: 9 });
    rig.run_ms(100);
    assert_eq!(errors(&rig.said()), [MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH]);
    assert_eq!(rig.node().parameters[2].value, Value::Real(1.5));
}

#[test]
fn a_node_without_parameters_says_so() {
    let mut rig = Rig::with_node(0);
    rig.say((1, 42), Request::ParameterList);
    rig.run_ms(100);
    assert_eq!(texts(&rig.said()), ["Node 42 has no parameters"]);
}
