#!/usr/bin/env bash
# Fetches and builds what the virtual machine needs, once: Debian's kernel with the modules of virtual hardware, gpio-sim (which Debian
# leaves out) built for it, and a small root file system. Result: tests/vm cache (LACQUER_VM_CACHE, default ~/.cache/lacquer-vm).
# Debian 12; root or sudo for the packages; about 250 MB to download.
set -euo pipefail
cache=${LACQUER_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/lacquer-vm}
if [ -f "$cache/ready" ]; then
  echo "virtual machine: prepared already in $cache"
  exit 0
fi
mkdir -p "$cache"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
as_root=""
[ "$(id -u)" = 0 ] || as_root=sudo

# The exact name: a pattern would fetch every kernel of the archive.
image=$(apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: \(linux-image-[0-9].*\)/\1/p' | head -1)
[ -n "$image" ] || { echo "virtual machine: apt knows no kernel; run apt-get update" >&2; exit 1; }
version=${image#linux-image-}
series=$(echo "$version" | cut -d. -f1,2)
echo "virtual machine: kernel $version"
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
  qemu-system-x86 busybox-static cpio kmod xz-utils make gcc-12 "linux-headers-$version" >/dev/null
(cd "$work" && apt-get download -qq "$image" "linux-source-$series")
mkdir "$work/image"
dpkg-deb --fsys-tarfile "$work/$image"_*.deb | tar -x -C "$work/image" ./boot ./lib/modules
cp "$work/image/boot/vmlinuz-$version" "$cache/vmlinuz"

echo "virtual machine: gpio-sim"
mkdir "$work/gpio"
dpkg-deb --fsys-tarfile "$work/linux-source-$series"_*.deb | tar -xO "./usr/src/linux-source-$series.tar.xz" |
  tar -xJ -C "$work/gpio" --strip-components=1 "linux-source-$series/drivers/gpio/gpio-sim.c" "linux-source-$series/drivers/gpio/gpiolib.h" \
    "linux-source-$series/kernel/irq/irq_sim.c"
mv "$work"/gpio/drivers/gpio/* "$work/gpio/kernel/irq/irq_sim.c" "$work/gpio/"
# irq_sim is part of the kernel only where something needs it; as a module it may not use irq_to_desc().
sed -i 's/irq_to_desc(irqnum)/irq_data_to_desc(irq_get_irq_data(irqnum))/; 1a #include <linux/irq.h>\n#include <linux/irqdesc.h>\n#include <linux/module.h>' "$work/gpio/irq_sim.c"
grep -q MODULE_LICENSE "$work/gpio/irq_sim.c" || echo 'MODULE_LICENSE("GPL");' >> "$work/gpio/irq_sim.c"
echo 'obj-m := irq_sim.o gpio-sim.o' > "$work/gpio/Makefile"
make -s -C "/usr/src/linux-headers-$version" M="$work/gpio" modules

echo "virtual machine: modules"
modules="$work/image/lib/modules/$version"
mkdir -p "$modules/extra" "$cache/modules"
cp "$work/gpio/irq_sim.ko" "$work/gpio/gpio-sim.ko" "$modules/extra/"
depmod -b "$work/image" "$version"
rm -f "$cache"/modules/* "$cache/order"
for module in configfs irq_sim gpio-sim vhci-hcd uvcvideo vivid; do
  modprobe -d "$work/image" -S "$version" --show-depends "$module" | awk '$1 == "insmod" {print $2}'
done | awk '!seen[$0]++' > "$work/list"
while read -r file; do
  cp "$file" "$cache/modules/"
  basename "$file" >> "$cache/order"
done < "$work/list"
cp /bin/busybox "$cache/busybox"
echo "$version" > "$cache/ready"
echo "virtual machine: ready in $cache, $(du -sh "$cache" | cut -f1)"
