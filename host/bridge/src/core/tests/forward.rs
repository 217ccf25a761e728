//! Tests of CAN forwarding to stations.

use super::rig::*;
use mavlink::dialects::common::{CAN_FILTER_MODIFY_DATA, CanFilterOp};

const FORWARD: Command =
    Command { number: command::CAN_FORWARD, params: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] };

fn can_frames(rig: &mut Rig) -> Vec<(u8, CAN_FRAME_DATA)> {
    picked(&rig.sent_messages(), |message| match message {
        MavMessage::CAN_FRAME(data) => Some(data.clone()),
        _ => None,
    })
}

#[test]
fn frames_are_forwarded_for_five_seconds_after_each_can_forward() {
    let mut rig = Rig::with_node(1);
    rig.send_request((0, 0), Request::Command(FORWARD));
    rig.run_ms(1000);
    let frames = can_frames(&mut rig);
    // The node's status and the bridge's own.
    let ids: BTreeSet<u32> = frames.iter().map(|frame| frame.1.id).collect();
    assert_eq!(ids, BTreeSet::from([0x9801_552A, 0x9801_557E]));
    let frame = &frames[0].1;
    assert_eq!(
        (frame.bus, frame.len, frame.target_system, frame.target_component),
        (0, 8, 255, 190)
    );
    rig.run_ms(5000);
    can_frames(&mut rig);
    rig.run_ms(3000);
    assert!(can_frames(&mut rig).is_empty());
    rig.command(126, command::CAN_FORWARD, &[2.0]);
    rig.run_ms(1);
    assert_eq!(rig.acks(), [(126, 32_000, DENIED, (255, 190))]);
}

#[test]
fn a_station_s_frame_goes_to_the_bus_and_to_the_other_stations() {
    let mut rig = Rig::with_node(1);
    let other = Asker { peer: 2, from: (254, 189), ..STATION };
    rig.send_request((0, 0), Request::Command(FORWARD));
    rig.send_request_as(other, (0, 0), Request::Command(FORWARD));
    let sent = CAN_FRAME_DATA {
        id: 0x9801_557F,
        target_system: 0,
        target_component: 0,
        bus: 0,
        len: 8,
        data: [1, 0, 0, 0, 0, 0, 0, 0xC0],
    };
    rig.send_request_as(other, (0, 0), Request::Frame(sent.clone()));
    assert_eq!(rig.bridge.frames, [Frame::extended(0x1801_557F, &sent.data)]);
    rig.run_ms(1);
    let posts = std::mem::take(&mut rig.posts);
    let shown = |(_, post): &(Duration, Post)| match post {
        Post::Message { to, class: Class::Frame, .. } => Some(*to),
        _ => None,
    };
    let to: Vec<To> = posts.iter().filter_map(shown).filter(|to| *to == To::One(2)).collect();
    // The bridge requests the new node's information, in one frame. The station's own frame does
    // not come back.
    assert_eq!(to.len(), 1);
    assert!(posts.iter().filter_map(shown).filter(|to| *to == To::One(1)).count() == 2);
    assert!(rig.bridge.nodes().contains_key(&NodeId::new(127).unwrap()), "a station is a node too");
    for wrong in [
        CAN_FRAME_DATA { bus: 1, ..sent.clone() },
        CAN_FRAME_DATA { len: 9, ..sent.clone() },
        CAN_FRAME_DATA { id: 0xE000_0001, ..sent.clone() },
    ] {
        rig.bridge.frames.clear();
        rig.send_request((0, 0), Request::Frame(wrong));
        assert!(rig.bridge.frames.is_empty());
    }
}

#[test]
fn a_filter_passes_only_its_types() {
    let mut rig = Rig::with_node(1);
    rig.command(126, command::CAN_FORWARD, &[1.0]);
    let filter = |operation, id: u16| {
        let mut ids = [0; 16];
        ids[0] = id;
        Request::Filter(CAN_FILTER_MODIFY_DATA {
            ids,
            target_system: 1,
            target_component: 126,
            bus: 1,
            operation,
            num_ids: 1,
        })
    };
    rig.send_request((1, 126), filter(CanFilterOp::CAN_FILTER_REPLACE, 1010));
    rig.run_ms(2000);
    assert!(can_frames(&mut rig).is_empty());
    rig.send_request((1, 126), filter(CanFilterOp::CAN_FILTER_ADD, 341));
    rig.run_ms(1000);
    assert_eq!(can_frames(&mut rig).len(), 2);
    rig.command(126, command::CAN_FORWARD, &[1.0]);
    rig.send_request((1, 126), filter(CanFilterOp::CAN_FILTER_REMOVE, 341));
    rig.run_ms(1000);
    assert!(can_frames(&mut rig).is_empty());
}
