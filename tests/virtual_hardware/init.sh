#!/bin/busybox sh
# First program in the guest, from the initial RAM disk.  The root file system is the host's,
# read-only over 9p, under a layer of RAM; only /guest_out is written back to the host.
B=/bin/busybox
$B mkdir -p /proc /sys /dev /host /layer /root
$B mount -t proc proc /proc
$B mount -t sysfs sysfs /sys
$B mount -t devtmpfs devtmpfs /dev
for module in $($B cat /modules.order); do
    $B insmod "/modules/$module" || echo "insmod $module failed"
done
$B mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=512000 host /host || $B poweroff -f
$B mount -t tmpfs tmpfs /layer
$B mkdir -p /layer/upper /layer/work
$B mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work overlay /root || $B poweroff -f
$B mkdir -p /root/guest_out
$B mount -t 9p -o trans=virtio,version=9p2000.L,cache=none,msize=512000 out /root/guest_out || $B poweroff -f
for each in proc sys dev; do $B mount --move "/$each" "/root/$each"; done
exec $B switch_root /root /bin/sh /guest_out/start.sh
