//! Tests of commands and their acknowledgements.

use super::rig::*;

#[test]
fn a_repeated_command_is_executed_once() {
    let mut rig = Rig::with_node(3);
    rig.node().is_silent = true;
    for _ in 0..3 {
        rig.command(42, command::PREFLIGHT_STORAGE, &[1.0]);
        rig.run_ms(300);
    }
    let in_progress = MavResult::MAV_RESULT_IN_PROGRESS;
    let results: Vec<MavResult> = rig.acks().into_iter().map(|ack| ack.2).collect();
    assert_eq!(results, [in_progress, in_progress]);
    rig.run_ms(3000);
    assert_eq!(rig.acks(), [(42, 245, FAILED, (255, 190))]);
    assert_eq!(rig.node().requests, 1 + 2, "one for the information, and two attempts");
}

#[test]
fn a_restart_without_an_answer_is_detected_by_the_uptime() {
    let mut rig = Rig::with_node(3);
    rig.run_ms(3000);
    rig.command(42, command::PREFLIGHT_REBOOT_SHUTDOWN, &[2.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(42, 246, DENIED, (255, 190))], "it can only be restarted");
    rig.node().lose_every = Some(1);
    rig.command(42, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(200);
    rig.node().uptime_s = 0;
    rig.run_ms(400);
    assert_eq!(rig.acks(), [(42, 246, ACCEPTED, (255, 190))]);
}

#[test]
fn a_requested_info_of_a_node_that_does_not_answer_fails() {
    let mut rig = Rig::new(vec![Simulated::new(42, 1)]);
    rig.node().lose_every = Some(1);
    rig.run_ms(3000);
    rig.sent_messages();
    rig.command(42, command::REQUEST_MESSAGE, &[311.0]);
    rig.run_ms(3000);
    assert_eq!(rig.acks(), [(42, 512, FAILED, (255, 190))]);
}

#[test]
fn commands_for_other_systems_or_components_are_ignored() {
    let mut rig = Rig::with_node(2);
    rig.send_request((2, 42), Request::ParameterList);
    rig.list(77);
    rig.command(77, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    // A PARAM_SET to all nodes.
    let value = f32::from_bits(5);
    rig.send_request((1, 0), Request::ParameterSet { name: "PARAM_1".into(), value, kind: INT32 });
    rig.run_ms(500);
    assert_eq!(
        (rig.sent_messages(), &rig.node().parameters[1].value),
        (vec![], &Value::Integer(10))
    );
}

#[test]
fn a_message_for_a_node_that_appears_a_moment_later_is_not_lost() {
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.list(42);
    rig.list(42);
    rig.command(43, command::PREFLIGHT_STORAGE, &[1.0]);
    rig.run_ms(1500);
    let sent = rig.sent_messages();
    let parameters =
        sent.iter().filter(|(_, content)| matches!(content, Content::Parameter { .. })).count();
    let acks = sent.iter().filter(|(_, content)| matches!(content, Content::Ack { .. })).count();
    assert_eq!((parameters, acks, rig.nodes[1].saved), (5, 1, 1));
    let mut rig = Rig::new(vec![Simulated::new(42, 5), Simulated::new(43, 3)]);
    rig.send_request((0, 0), Request::ParameterList);
    rig.run_ms(3500);
    assert_eq!(rig.parameters().len(), 8);
    // The early message has expired.
    let mut rig = Rig::new(vec![Simulated::new(42, 5)]);
    rig.node().is_silent = true;
    rig.list(42);
    rig.run_ms(4500);
    rig.node().is_silent = false;
    rig.run_ms(2000);
    assert!(rig.parameters().is_empty());
}

#[test]
fn node_1_is_restarted_by_both_forms_of_the_command_where_the_bridge_is_component_1() {
    let mut rig = Rig::new(vec![Simulated::new(1, 0)]);
    rig.bridge.state.settings.component = 1;
    rig.run_ms(1500);
    rig.sent_messages();
    rig.command(1, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(10);
    rig.command(1, command::PREFLIGHT_REBOOT_SHUTDOWN, &[0.0, 0.0, 1.0, 1.0]);
    rig.run_ms(10);
    rig.command(1, command::PREFLIGHT_STORAGE, &[2.0]);
    rig.run_ms(10);
    let results: Vec<MavResult> = rig.acks().into_iter().map(|ack| ack.2).collect();
    assert_eq!((results, rig.node().restarts, rig.node().erased), (vec![ACCEPTED; 3], 2, 1));
    // The bridge's component is not all nodes here, component 0 is.
    rig.command(0, command::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]);
    rig.run_ms(10);
    assert_eq!(rig.acks(), [(1, 246, DENIED, (255, 190))]);
}

#[test]
fn a_command_without_a_node_fails() {
    let mut rig = Rig::new(Vec::new());
    rig.run_ms(100);
    rig.command(0, command::PREFLIGHT_STORAGE, &[1.0]);
    rig.command(126, command::UAVCAN_GET_NODE_INFO, &[]);
    rig.run_ms(10);
    let sent = rig.sent_messages();
    assert_eq!(texts(&sent), ["No node is online"; 2]);
    let result = |(_, content)| match content {
        Content::Ack { result, .. } => Some(result),
        _ => None,
    };
    assert_eq!(sent.into_iter().filter_map(result).collect::<Vec<_>>(), [FAILED; 2]);
}

#[test]
fn each_node_that_does_not_save_is_named() {
    let mut rig = Rig::online((42..46).map(|id| Simulated::new(id, 1)).collect());
    rig.nodes[1].rejects_opcodes = true;
    rig.nodes[2].rejects_opcodes = true;
    rig.nodes[3].lose_every = Some(1);
    rig.command(0, command::PREFLIGHT_STORAGE, &[1.0]);
    rig.run_ms(3100);
    let sent = rig.sent_messages();
    assert_eq!(texts(&sent), ["Node 43 refuses", "Node 44 refuses", "Node 45 does not answer"]);
    assert!(sent.iter().any(|(_, content)| matches!(content, Content::Ack { result: FAILED, .. })));
}

#[test]
fn autopilot_version_has_the_whole_unique_id() {
    let mut rig = Rig::with_node(0);
    rig.command(126, command::REQUEST_MESSAGE, &[148.0]);
    rig.run_ms(1);
    assert!(matches!(
        rig.sent_messages()[1].1,
        Content::Capabilities { unique_id, .. } if unique_id == [7; 16]
    ));
}
